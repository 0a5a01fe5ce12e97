# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What an analysis could have reached: the true structure fitted to the same record.

The machinery is the loop's own, without the choice: the effects that the answer names, from their
true values on, with the parameters of the arm, by prediction errors.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from puma_sim_core.effects import KINDS, VISCOUS, Effect
from puma_sim_core.errors import PumaSimError
from puma_sim_core.identify.data.ingest import read_log
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import PredictionFit
from puma_sim_core.identify.fitting.trials import Trials
from puma_sim_core.identify.noise import innovations
from puma_sim_core.identify.prepare import prepare
from puma_sim_core.identify.selection.cross_validation import CrossValidation, WeightedModel
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.plant.plant import Plant

_ROUNDS = 4


class Bench:
    """One record with everything to fit models to it and to measure them on the validation set."""

    def __init__(self, path):
        self.mechanism = m = load_mechanism()
        log = read_log(str(path), None, m.joints)
        prepared = prepare([log], m)
        self.problem, self.library, self.search = prepared.problem, prepared.library, prepared.search
        self.retuned, self.predictor = prepared.retuned, prepared.predictor
        self.folds = CrossValidation.of(self.problem, self.predictor, prepared.validation)

    def true_structure(self, answer: dict) -> dict[str, list[float] | None]:
        """(J,) position errors [rad] of the true structure, as a report gives them ("held_out"), and
        in the blocks alone that no choice has seen ("unseen"); None where it cannot be run."""
        m, predictor = self.mechanism, self.predictor
        try:
            true = m.of_plant(_true_arm(m, answer["parameters"]))
            effects = _true_effects(m, true.start, answer["effects"])
            trials = Trials(predictor, self.problem)
            point = Point(m.clip(true.start), effects)
            raw = predictor.errors(m.plant(point.theta, effects))
            weighting = predictor.unfiltered_weighting(raw)
            for _ in range(2):
                fitted = PredictionFit(predictor, weighting).run(point, trials.free(point), rounds=_ROUNDS)
                point = fitted.point
                model = WeightedModel(fitted, weighting)
                weighting = innovations.weighting(predictor, predictor.errors(m.plant(point.theta, point.effects)))
            return {"held_out": _finite(self.folds.position_rms(model)), "unseen": _finite(self.folds.unseen(point))}
        except PumaSimError:
            return {"held_out": None, "unseen": None}

    def position_rms(self, theta, effects) -> list[float] | None:
        """(J,) open-loop position errors [rad] in the blocks that no choice has seen; None where a
        model cannot be run."""
        try:
            with np.errstate(all="ignore"):
                return _finite(self.folds.unseen(Point(theta, tuple(effects))))
        except PumaSimError:
            return None


def _finite(errors) -> list[float] | None:
    return errors.tolist() if np.isfinite(errors).all() else None


def _true_arm(mechanism, p: dict) -> Plant:
    """The rigid arm of an answer."""

    def column(j, *names):
        return tuple(float(p[name][j]) for name in names)

    arm = mechanism.arm
    links = tuple(
        replace(
            link,
            mass=float(p["m"][j]),
            centre=column(j, "x", "y", "z"),
            gyration_squared=column(j, "kxx", "kyy", "kzz"),
        )
        for j, link in enumerate(arm.links)
    )
    motors = tuple(
        replace(motor, resistance=R, inductance=L, back_emf=ke, torque_constant=kt, inertia=Ia)
        for j, motor in enumerate(arm.motors)
        for R, L, ke, kt, Ia in [column(j, "R", "L", "ke", "kt", "Ia")]
    )
    viscous = tuple(Effect(VISCOUS, j + 1, {"coefficient": float(p["H"][j])}) for j in range(3))
    return Plant(replace(arm, links=links, motors=motors), viscous)


def _true_effects(mechanism, theta, effects: list[dict]) -> tuple[Effect, ...]:
    made = []
    for effect in effects:
        kind = KINDS[effect["name"]]
        known = {p.name for p in kind.parameters}
        made.append(
            Effect(
                kind,
                effect["joint"],
                {name: float(value) for name, value in effect["parameters"].items() if name in known},
            )
        )
    plant = mechanism.plant(theta, made)
    return tuple(plant.effects[len(plant.effects) - len(made) :]) if made else ()
