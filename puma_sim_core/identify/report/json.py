# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""An explanation as `report.json`; `config/explain_report.schema.json` describes the layout.

The same explanation gives the same bytes. `seconds`, which alone changes from run to run, stands
on a line of its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from puma_sim_core import __version__
from puma_sim_core.identify.result import (
    NOT_EXCITED,
    PARTS,
    Detectable,
    Errors,
    Explanation,
    FeedbackBias,
    Hypothesis,
    NamedEffect,
    NextExperiment,
    Ranked,
    RuledOut,
    Shape,
    StageErrors,
)
from puma_sim_core.json_text import json_text

#: raised when the layout of the file changes
FORMAT = 1
STAGES = ("nominal", "retuned", "augmented", "floor")


def report_text(explanation: Explanation) -> str:
    """The whole text of `report.json`."""
    return json_text(report_mapping(explanation))


def report_mapping(explanation: Explanation) -> dict[str, Any]:
    """Plain values of `report.json`, in the order of the file; what is not finite is None."""
    e = explanation
    return _plain(
        {
            "verdict": e.verdict,
            "sentence": e.sentence,
            "effects": [_effect(each) for each in e.effects],
            "errors": {part: _errors(e.errors.get(part)) for part in PARTS},
            "shape": None if e.shape is None else _shape(e.shape),
            "faults": [{"channel": f.channel, "row": f.row, "what": f.what} for f in e.faults],
            "detectability": [_detectable(each) for each in e.detectability],
            "next_experiment": None if e.next_experiment is None else _next(e.next_experiment),
            "feedback_bias": None if e.feedback_bias is None else _feedback(e.feedback_bias),
            "ranking": [_ranked(each) for each in e.ranking],
            "parameters": {name: _parameter(*values) for name, values in e.parameters.items()},
            "notes": list(e.notes),
            "mechanism": e.mechanism,
            "position_unit": e.position_unit,
            "voltage_unit": e.voltage_unit,
            "logs": list(e.logs),
            "held_out_logs": list(e.held_out_logs),
            "seconds": float(e.seconds),
            "version": e.version or __version__,
            "seed": e.seed,
            "format": FORMAT,
        }
    )


def _hypothesis(each: Hypothesis | RuledOut | Ranked | Detectable | NamedEffect) -> dict[str, Any]:
    return {"name": each.name, "joint": each.joint}


def _hypotheses(found: Iterable) -> list[dict[str, Any]]:
    return [_hypothesis(each) for each in found]


def _effect(effect: NamedEffect) -> dict[str, Any]:
    return {
        **_hypothesis(effect),
        "parameters": {
            name: {"value": found.value, "ci95": [found.low, found.high], "unit": found.unit}
            for name, found in effect.parameters.items()
        },
        "evidence": effect.evidence,
        "tied_with": _hypotheses(effect.tied_with),
        "ruled_out": [{**_hypothesis(each), "because": each.because} for each in effect.ruled_out],
    }


def _errors(errors: Errors | None) -> dict[str, Any] | None:
    return (
        None
        if errors is None
        else {"voltage_rms": _stages(errors.voltage_rms), "position_rms": _stages(errors.position_rms)}
    )


def _stages(errors: StageErrors) -> dict[str, Any]:
    return {stage: np.atleast_1d(getattr(errors, stage)) for stage in STAGES}


def _shape(shape: Shape) -> dict[str, Any]:
    return {
        "axis": shape.axis,
        "axis_unit": shape.axis_unit,
        "way": shape.way,
        "joint": shape.joint,
        "line_hz": shape.line_hz,
        "centre": shape.centre,
        "curve": shape.curve,
        "band": [[low, high] for low, high in zip(shape.low, shape.high)],
        "ranking": [{"axis": axis, "evidence": gain} for axis, gain in shape.ranking],
    }


def _detectable(each: Detectable) -> dict[str, Any]:
    return {
        **_hypothesis(each),
        "parameter": each.parameter,
        "size": each.size if each.excited else NOT_EXCITED,
        "unit": each.unit,
        "needed": each.size,
    }


def _next(found: NextExperiment) -> dict[str, Any]:
    return {"sentence": found.sentence, "separate": _hypotheses(found.separate), "command": found.command}


def _feedback(found: FeedbackBias) -> dict[str, Any]:
    return {
        "biased": found.biased,
        "sentence": found.sentence,
        "statistic": np.atleast_1d(found.statistic),
        "p_value": np.atleast_1d(found.p_value),
        "instruments": found.instruments,
    }


def _ranked(each: Ranked) -> dict[str, Any]:
    return {**_hypothesis(each), "evidence": each.evidence, "verdict": each.verdict}


def _parameter(start: float, retuned: float, unit: str, prior_width: float | None = None) -> dict[str, Any]:
    return {"start": start, "retuned": retuned, "unit": unit, "prior_width": prior_width}


def _plain(value: Any) -> Any:
    """Types of JSON: numbers of NumPy as Python's, texts without lone surrogates (which a file
    name that is no UTF-8 has), None for what is not finite."""
    if isinstance(value, dict):
        return {_plain(str(name)): _plain(each) for name, each in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    if isinstance(value, str):
        return value.encode("utf-8", "replace").decode("utf-8")
    if value is None or isinstance(value, (bool, np.bool_)):
        return None if value is None else bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    return float(value) if math.isfinite(value) else None
