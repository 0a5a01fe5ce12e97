# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The laws of all effects, combined point by point: what the step calls.

Each function here is written out from the registry, as one would by hand: the sum of two laws is
``p[k + 12] + f1(p, k + 31, q, qd)``, where a law that is one expression stands as it is and a longer one is called. So
it costs what a sum written by hand costs, compiled or not. p is the packed table of effects and k the place where the
part of joint j begins; laws of the whole arm take j = 0.
"""

import ast
import builtins
import inspect
import textwrap
from collections.abc import Callable
from typing import Any

from puma_sim_core.effects import registry
from puma_sim_core.effects.base import Point, Stage
from puma_sim_core.jit import inlined, interpreted, written

#: parameters of one joint in the packed table
WIDTH = registry.WIDTH
#: stages of the step, as the plain integers that compiled code takes
SMOOTH, DRY, VARYING, POSED = Stage.SMOOTH.value, Stage.DRY.value, Stage.VARYING.value, Stage.POSED.value
BRISTLE, TILT, TIMED, DROOP = Stage.BRISTLE.value, Stage.TILT.value, Stage.TIMED.value, Stage.DROOP.value
CURRENT_LIMIT, LOCKED, ALGEBRAIC = Stage.CURRENT_LIMIT.value, Stage.LOCKED.value, Stage.ALGEBRAIC.value
SENSED, DELAYED, TWO_MASS, MEMORY = (Stage.SENSED.value, Stage.DELAYED.value, Stage.TWO_MASS.value, Stage.MEMORY.value)

_JOINED = {"sum": " + ", "product": " * ", "any": " or "}
_EMPTY = {"sum": "0.0", "product": "1.0", "any": "False", "least": "inf", "triple": "(0.0, 0.0, 0.0)"}


class _Inlining(ast.NodeTransformer):
    """Put a call's arguments for the parameters of a law, its place for k, and names of its own for its globals."""

    def __init__(self, function: Callable[..., Any], prefix: str, arguments: list[str], place: int):
        self.names = dict(zip(inspect.signature(function).parameters, ["p", f"k + {place}", *arguments]))
        self.scope, self.prefix, self.place = function.__globals__, prefix, place
        self.used: dict[str, Any] = {}

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        match node:
            case ast.BinOp(ast.Name("k"), ast.Add(), ast.Constant(int(further))):
                return ast.parse(f"k + {self.place + further}", mode="eval").body
        return self.generic_visit(node)

    def visit_Name(self, node: ast.Name) -> ast.AST:
        if node.id in self.names:
            return ast.parse(self.names[node.id], mode="eval").body
        if node.id in self.scope:
            self.used[self.prefix + node.id] = self.scope[node.id]
            return ast.Name(self.prefix + node.id, ast.Load())
        if not hasattr(builtins, node.id):
            raise NameError(node.id)
        return node


def _expression(
    function: Callable[..., Any], prefix: str, arguments: list[str], place: int
) -> tuple[str, dict[str, Any]] | None:
    """Source of a law that is one expression, with its arguments in it, and the globals that it uses; else None."""
    try:
        definition = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    except (OSError, SyntaxError):  # no source, or not by itself
        return None
    if not isinstance(definition, ast.FunctionDef):
        return None
    *before, last = definition.body
    if len(before) > (ast.get_docstring(definition) is not None) or not isinstance(last, ast.Return) or not last.value:
        return None
    inlining = _Inlining(function, prefix, arguments, place)
    try:
        return f"({ast.unparse(inlining.visit(last.value))})", inlining.used
    except NameError:  # a closure's
        return None


def combined(point: Point, jit: Callable[..., Any] = inlined) -> Callable[..., Any]:
    """The laws at a point as one function of (j, arguments of the point, p), j = 0, 1, 2 the joint.

    jit : `jit.interpreted` gives the plain Python of it.
    """
    how, arguments = point.combined, [name for name in point.arguments.split(", ") if name]
    calls: list[str] = []
    functions: dict[str, Any] = {}
    for n, (function, place) in enumerate(registry.laws(point)):
        call = f"f{n}({', '.join(['p', f'k + {place}', *arguments])})"
        call, used = _expression(interpreted(function), f"f{n}_", arguments, place) or (call, {f"f{n}": function})
        calls.append(call)
        functions |= used
    if jit is not inlined:
        functions = {name: jit(value) for name, value in functions.items()}
    body = [f"k = j * {WIDTH}"] if calls else []
    if how == "chain":
        body += [*(f"{arguments[-1]} = {call}" for call in calls), f"return {arguments[-1]}"]
    elif how == "triple" and len(calls) > 1:
        body += ["t1, t2, t3 = 0.0, 0.0, 0.0"]
        for call in calls:
            body += [f"u1, u2, u3 = {call}", "t1, t2, t3 = t1 + u1, t2 + u2, t3 + u3"]
        body += ["return t1, t2, t3"]
    elif how == "least":
        value = calls[0] if calls else _EMPTY[how]
        for call in calls[1:]:
            value = f"min({value}, {call})"
        body += [f"return {value}"]
    else:
        body += [f"return {_JOINED.get(how, '').join(calls) or _EMPTY[how]}"]
    return written(point.name.lower(), ", ".join(["j", *arguments, "p"]), body, functions, jit)


after_losses = combined(Point.TERMINAL)
within_supply = combined(Point.SUPPLY)
supply_share = combined(Point.SUPPLY_SHARE)
bounded_rate = combined(Point.CURRENT_RATE)
bounded_current = combined(Point.CURRENT)
current_bound = combined(Point.CURRENT_BOUND)
motor_torque = combined(Point.MOTOR_TORQUE)
link_torque = combined(Point.LINK_TORQUE)
constant_level = combined(Point.LEVEL)
speed_level = combined(Point.SPEED_LEVEL)
pose_level = combined(Point.POSE_LEVEL)
has_pose_level = combined(Point.HAS_POSE_LEVEL)
loaded_torque = combined(Point.LOADED_TORQUE)
bristle_stiffness = combined(Point.BRISTLE_STIFFNESS)
arm_torques = combined(Point.ARM_TORQUE)
resistance_factor = combined(Point.RESISTANCE_FACTOR)
viscous_factor = combined(Point.VISCOUS_FACTOR)
push_torque = combined(Point.PUSH)
sensor_offset = combined(Point.SENSOR_OFFSET)
sensor_error = combined(Point.SENSOR_ERROR)
sensor_slope = combined(Point.SENSOR_SLOPE)
sensor_time = combined(Point.SENSOR_LAG)

#: effects with a deflection of their own; numbers of all deflections: three of the bristles, then three of each
MEMORIES = registry.memories()
DEFLECTIONS = 3 + 3 * len(MEMORIES)
#: numbers of z: deflections of the bristles, positions and velocities of the links, further deflections
Z_WIDTH = 6 + DEFLECTIONS


def _memory_lines() -> tuple[list[str], dict[str, Any]]:
    lines: list[str] = []
    functions: dict[str, Any] = {}
    for n, (follow, torque, place) in enumerate(MEMORIES):
        functions |= {f"follow{n}": follow, f"torque{n}": torque}
        for j in range(3):
            k = j * WIDTH + place
            lines.append(f"s{n}_{j} = follow{n}(p, {k}, z[{3 + 3 * n + j}], t{j + 1})")
            lines.append(f"f{j + 1} = f{j + 1} + torque{n}(p, {k}, s{n}_{j})")
    return lines, functions


def deflection_torques(bristle_step: Callable[..., Any]) -> Callable[..., Any]:
    """(z, t1, t2, t3, level, p) -> deflections after travels t [rad], and their torques [N.m].

    z : deflections at the start, DEFLECTIONS numbers; level : bounds of the bristles [N.m]; bristle_step : (j, z,
    travel, level, p) -> deflection and torque of a bristle.
    """
    lines, functions = _memory_lines()
    body = [f"z{j + 1}, f{j + 1} = bristle_step({j}, z[{j}], t{j + 1}, level[{j}], p)" for j in range(3)]
    ends = ", ".join(["z1", "z2", "z3", *(f"s{n}_{j}" for n in range(len(MEMORIES)) for j in range(3))])
    body += [*lines, f"return ({ends}), (f1, f2, f3)"]
    return written("deflection_torques", "z, t1, t2, t3, level, p", body, {**functions, "bristle_step": bristle_step})


def _numbers(name: str, first: int, count: int) -> list[str]:
    return [f"{name}[{n}]" for n in range(first, first + count)]


#: z -> the deflections in it
deflections_of = written(
    "deflections_of", "z", [f"return ({', '.join(_numbers('z', 0, 3) + _numbers('z', 9, DEFLECTIONS - 3))})"], {}
)
#: (z, b) -> z with the deflections b
with_deflections = written(
    "with_deflections",
    "z, b",
    [f"return ({', '.join(_numbers('b', 0, 3) + _numbers('z', 3, 6) + _numbers('b', 3, DEFLECTIONS - 3))})"],
    {},
)
#: (z, s) -> z with positions and velocities s of the links
with_links = written(
    "with_links",
    "z, s",
    [f"return ({', '.join(_numbers('z', 0, 3) + _numbers('s', 0, 6) + _numbers('z', 9, DEFLECTIONS - 3))})"],
    {},
)
#: z of deflections that are none
UNBENT = (0.0,) * DEFLECTIONS
#: z of a joint at rest whose links are at 0
AT_REST = (0.0,) * Z_WIDTH


def row_readers(row: int) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """(out, r, active) -> deflections, and (out, r) -> z, of row r of a run.

    A row holds x, the bristles, and from column `row` on, where it is wide, measured positions and the rest of z.
    """
    narrow = [f"out[r, {9 + n}]" for n in range(3)]
    links = [f"out[r, {row + n}]" for n in range(3, 9)]
    further = [f"out[r, {row + n}]" for n in range(9, Z_WIDTH)]
    lines = [f"return ({', '.join(narrow)})"]
    if further:
        lines = [
            f"if active & {MEMORY}:",
            f"    return ({', '.join(narrow + further)})",
            f"return ({', '.join(narrow + ['0.0'] * len(further))})",
        ]
    return (
        written("deflections_in_row", "out, r, active", lines, {}),
        written("z_in_row", "out, r", [f"return ({', '.join(narrow + links + further)})"], {}),
    )
