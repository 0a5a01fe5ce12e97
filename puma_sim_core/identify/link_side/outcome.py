# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What the comparison of both sides of transmissions says, in words and as a verdict."""

from collections.abc import Sequence

from puma_sim_core.identify import result
from puma_sim_core.identify.link_side import terms
from puma_sim_core.identify.settings import RESIDUALS
from puma_sim_core.pages.text import listed, scale


def explanation(found: Sequence[result.LinkSide], unit: str) -> result.Explanation:
    """The explanation of a machine of which only the transmissions are described; unit : of positions."""
    if not found:
        fault = result.Fault.of("position1", None, "no joint moves on both sides", "a motion of some seconds")
        refused = f"The data cannot be used: {fault.channel}: {fault.what}."
        return result.Explanation(result.DATA_FAULT, refused, faults=(fault,))
    named = [
        result.NamedEffect(effect.name, side.joint, effect.parameters, effect.evidence)
        for side in found
        for effect in side.effects
    ]
    rest = any(beyond(side) for side in found)
    verdict = result.NAMED if named else result.NOTHING_MISSING
    if rest:
        verdict = result.NAMED_WITH_REMAINDER if named else result.UNNAMED
    effects = tuple(sorted(named, key=lambda each: -each.evidence))
    text = " ".join(sentence(side, unit) for side in found)
    return result.Explanation(verdict, text, effects, link_side=tuple(found))


def beyond(side: result.LinkSide) -> bool:
    """Whether what is left of a joint's difference is clearly more than the steps of its sensors."""
    return side.held_out_after > RESIDUALS.link_beyond * side.floor


def sentence(side: result.LinkSide, unit: str) -> str:
    """What is found on a joint, in one sentence."""
    factor, shown = scale([side.held_out_before, side.held_out_after], unit)
    before, after = (f"{each * factor:.3g} {shown}" for each in (side.held_out_before, side.held_out_after))
    if not side.effects:
        rest = "which no effect explains" if beyond(side) else "no more than the steps of the two sensors make"
        return f"On joint {side.joint} the link's reading differs from the motor's by {before}, {rest}."
    words = listed([_words(effect) for effect in side.effects])
    text = f"On joint {side.joint} {words}; the difference of the readings falls from {before} to {after}"
    return f"{text}, more than the steps of the sensors." if beyond(side) else f"{text}."


def _words(effect: result.LinkEffect) -> str:
    ((name, size),) = effect.parameters.items()
    factor, shown = scale([size.value], size.unit)
    value = f"{size.value * factor:.3g} {shown}"
    if effect.name == terms.LAG:
        law = "a lag or a delay" if effect.either_law else "a lag of first order" if effect.law == "lag" else "a delay"
        return f"the {effect.sensor}'s reading is late by {value} ({law})"
    verb = "twists" if effect.name == terms.ELASTICITY else "has backlash"
    return f"the transmission {verb} ({name} {value})"
