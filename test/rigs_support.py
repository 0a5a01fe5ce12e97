# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Answers of the bench of real machines, made by hand."""

from __future__ import annotations


def effect(name, joint, ties=(), **sizes):
    return {
        "name": name,
        "joint": joint,
        "evidence": 50.0,
        "tied_with": [{"name": n, "joint": j} for n, j in ties],
        "ruled_out": [],
        "parameters": {key: {"value": v, "ci95": [low, high], "unit": "1"} for key, (v, low, high) in sizes.items()},
    }


def report(verdict, *effects, shape=None, faults=()):
    stages = {stage: [1.0] for stage in ("nominal", "retuned", "augmented", "floor")}
    return {
        "verdict": verdict,
        "sentence": "x",
        "effects": list(effects),
        "shape": None if shape is None else {"axis": shape[0], "joint": shape[1], "way": "", "line_hz": None},
        "errors": {"fit": None, "held_out": {"voltage_rms": stages, "position_rms": stages}, "unseen": None},
        "position_unit": "rad",
        "voltage_unit": "V",
        "faults": [{"channel": channel} for channel in faults],
    }


def outcome(given_report, **more):
    return {
        "report": given_report,
        "error": None,
        "applies": True,
        "seconds": 3.0,
        "megabytes": 9,
        "ours": None,
        **more,
    }
