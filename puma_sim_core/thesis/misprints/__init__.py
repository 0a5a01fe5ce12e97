# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The misprints of the thesis, each with the computation that proves it.

``errata_CHAPTER.yaml`` says what is printed, what would be right, what is compared and by what; the
module of the chapter has the proofs and the errata, ``ROWS``. A proof sets the printed and the corrected
form beside a reference that was derived in another way. :mod:`puma_sim_core.thesis.errata` gathers all.
"""
