# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The scored batch: `make score`, on fresh blind records, beside three baselines.

`plan` says which records, `jobs` makes and explains one, `reference` fits its true structure,
`baselines` are what anyone would try first, `scoring` compares with the answers, `table` prints.
The generator (`blind`) stands apart and shares no code with the project.
"""
