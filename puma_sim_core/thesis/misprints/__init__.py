# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The misprints of the thesis as data, each with the computation that proves it.

A row is an :class:`~puma_sim_core.thesis.misprints.evidence.Erratum`. Its evidence sets the printed
and the corrected form beside a reference that was derived in another way. One module a group of
chapters, each with a tuple ``ROWS``; :mod:`puma_sim_core.thesis.errata` gathers them.
"""
