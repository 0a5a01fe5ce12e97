# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""An explanation as `report.json`; `config/explain_report.schema.json` describes the layout.

The same explanation gives the same bytes but for `seconds`, which stands on a line of its own.
"""

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from puma_sim_core import __version__
from puma_sim_core.identify import result
from puma_sim_core.json_text import json_text

#: raised when the layout of the file changes
FORMAT = 1
STAGES = ("nominal", "retuned", "augmented", "floor")


def report_text(explanation: result.Explanation) -> str:
    """The whole text of `report.json`."""
    return json_text(report_mapping(explanation))


def report_mapping(explanation: result.Explanation) -> dict[str, Any]:
    """Plain values of `report.json`, in the order of the file; what is not finite is None."""
    e = explanation
    return _plain(
        {
            "verdict": e.verdict,
            "sentence": e.sentence,
            "effects": [_effect(each) for each in e.effects],
            "errors": {part: _errors(e.errors[part]) if part in e.errors else None for part in result.PARTS},
            "shape": None if e.shape is None else _shape(e.shape),
            "faults": [asdict(each) for each in e.faults],
            "cuts": [asdict(each) for each in e.cuts],
            "detectability": [_detectable(each) for each in e.detectability],
            "next_experiment": None if e.next_experiment is None else asdict(e.next_experiment),
            "agreement": None if e.agreement is None else _agreement(e.agreement),
            "link_side": [_link_side(each) for each in e.link_side],
            "feedback_bias": None if e.feedback_bias is None else _feedback(e.feedback_bias),
            "ranking": [asdict(each) for each in e.ranking],
            "parameters": {
                name: dict(zip(("start", "retuned", "unit", "prior_width"), (*values, None)))
                for name, values in e.parameters.items()
            },
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


def _effect(effect: result.NamedEffect | result.LinkEffect) -> dict[str, Any]:
    parameters = {
        name: {"value": found.value, "ci95": [found.low, found.high], "unit": found.unit}
        for name, found in effect.parameters.items()
    }
    return {**asdict(effect), "parameters": parameters}


def _link_side(side: result.LinkSide) -> dict[str, Any]:
    effects = [{**asdict(each), "parameters": _effect(each)["parameters"]} for each in side.effects]
    return {**asdict(side), "effects": effects}


def _errors(errors: result.Errors) -> dict[str, Any]:
    return {
        quantity: {stage: np.atleast_1d(values) for stage, values in stages.items()}
        for quantity, stages in asdict(errors).items()
    }


def _shape(shape: result.Shape) -> dict[str, Any]:
    plain = ("axis", "axis_unit", "way", "joint", "line_hz", "centre", "curve")
    return {
        **{name: getattr(shape, name) for name in plain},
        "band": [[low, high] for low, high in zip(shape.low, shape.high)],
        "ranking": [{"axis": axis, "evidence": gain} for axis, gain in shape.ranking],
    }


def _detectable(each: result.Detectable) -> dict[str, Any]:
    fields = asdict(each)
    excited = fields.pop("excited")
    return {**fields, "size": each.size if excited else result.NOT_EXCITED, "needed": each.size}


def _agreement(found: result.Agreement) -> dict[str, Any]:
    def interval(each: result.Interval | None) -> dict[str, Any] | None:
        return None if each is None else {"value": each.value, "ci95": [each.low, each.high]}

    effects = [
        {
            "name": effect.name,
            "joint": effect.joint,
            "states": effect.states,
            "sizes": [
                {
                    "parameter": size.parameter,
                    "law": size.law,
                    "unit": size.unit,
                    "found": [interval(each) for each in size.found],
                    "mean": interval(size.mean),
                    **{name: getattr(size, name) for name in ("q", "p_value", "i2", "agrees")},
                }
                for size in effect.sizes
            ],
        }
        for effect in found.effects
    ]
    return {"sentence": found.sentence, "logs": found.logs, "verdicts": found.verdicts, "effects": effects}


def _feedback(found: result.FeedbackBias) -> dict[str, Any]:
    arrays = {name: np.atleast_1d(getattr(found, name)) for name in ("statistic", "p_value")}
    return {"biased": found.biased, "sentence": found.sentence, **arrays, "instruments": found.instruments}


def _plain(value: Any) -> Any:
    """Types of JSON: numbers as Python's, texts without lone surrogates (of file names), None if not finite."""
    if isinstance(value, dict):
        return {_plain(str(name)): _plain(each) for name, each in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    if isinstance(value, str):
        return value.encode("utf-8", "replace").decode("utf-8")
    if isinstance(value, np.generic):
        return _plain(value.item())
    return value if value is None or isinstance(value, int) or math.isfinite(value) else None
