# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Pages that are derived from the code at each build: effects, equations, API reference, table of measures."""

from __future__ import annotations

import ast
import itertools
import re
from pathlib import Path

import puma_sim_core as ps
from puma_sim_core.appraisal.measures import MEASURES
from puma_sim_core.effects import KINDS
from puma_sim_core.plant.quantities import AMPLIFIERS, BASE_LINK, BODY, DRIVES, GRAVITY, LINK

DOCS = Path(__file__).resolve().parents[1]
CORE = DOCS.parent / "puma_sim_core"
#: what the docstrings call an equation or table of the thesis: "equation 4.1", "equations 7.5 to 7.7"
_REFERENCE = re.compile(r"\b(equations?|tables?) (\d\.\d+(?:(?:, | and | to )\d\.\d+)*)")


def effects_page() -> str:
    """One section for each effect of the registry."""
    firsts = [kind for kind in KINDS.values() if kind.number == 1]
    lines = [
        "# Effects",
        "",
        "Made from the registry `puma_sim_core.effects.KINDS`. `puma-sim list` prints the same.",
        "",
        "| effect | acts on | in one sentence |",
        "|---|---|---|",
    ]
    lines += [f"| [{k.name}](#{_anchor(k.name)}) | {k.acts} | {_cell(k.sentence)} |" for k in firsts]
    for kind in firsts:
        lines += ["", f"({_anchor(kind.name)})=", f"## `{kind.name}`", "", kind.sentence, "", *_literal(kind.equation)]
        where = "one joint" if kind.per_joint else "the whole arm"
        lines += ["", f"Acts on the {kind.acts} of {where}."]
        if kind.further:
            names = ", ".join(f"`{each.name}`" for each in kind.further)
            lines += ["", f"Up to {kind.most} of it may act on one joint. Those after the first are {names}."]
        lines += ["", "| parameter | unit | bounds | default | meaning |"]
        lines += ["|---|---|---|---|---|"]
        for p in kind.parameters:
            default = "required" if p.default is None and p.from_arm is None else "from the arm"
            default = default if p.default is None else f"{p.default:g}"
            lines.append(f"| `{p.name}` | {p.unit} | {p.low:g} to {p.high:g} | {default} | {_cell(p.meaning)} |")
        screening = kind.screening
        if screening is None:
            lines += ["", "`explain` does not look for this effect: it is simulated only."]
            continue
        lines += ["", f"**Excitation.** {screening.excitation}"]
        if kind.look_alikes:
            lines += ["", "| look-alike | what tells the two apart |", "|---|---|"]
            lines += [f"| `{name}` | {_cell(difference)} |" for name, difference, _ in kind.look_alikes]
    return "\n".join(lines) + "\n"


def mechanism_numbers_page() -> str:
    """The numbers of mechanism files, group by group."""
    lines = [
        "# Numbers of mechanism files",
        "",
        "Made from `puma_sim_core.plant.quantities`, by which the files are read.",
    ]
    groups = {
        "`link` of the base": BASE_LINK,
        "`link` of shoulder and elbow": LINK,
        "`body` of a pendulum; of a slide the mass alone": {**BODY, "gravity": GRAVITY},
        **{f"`drive` with `amplifier: {name}`, {AMPLIFIERS[name]}": numbers for name, numbers in DRIVES.items()},
    }
    for title, numbers in groups.items():
        lines += [
            "",
            f"## {title}",
            "",
            "| number | unit | on a slide | may be | without it | |",
            "|---|---|---|---|---|---|",
        ]
        for name, q in numbers.items():
            default = "required" if q.default is None else f"{q.default}"
            slide = " or ".join(q.slide) if q.slide else ""
            row = (f"`{name}`", " or ".join(q.units), slide, q.sign, default, _cell(q.meaning))
            lines.append(f"| {' | '.join(row)} |")
    lines += [
        "",
        "A link has one direction along it, from its joint to the next or to its end; one across it in the plane",
        "of motion, the first turned by +90 degrees of the joint; and one beside that plane, along the joint's axis.",
        "`beside`, `inertia_along` and `inertia_across` count where the base moves, and are unknown keys elsewhere;",
        "`length` belongs to a shoulder with an elbow. The `gravity` of a linkage stands beside its axes.",
    ]
    return "\n".join(lines) + "\n"


def equations_page() -> str:
    """Equations and tables of the thesis with the definitions whose docstrings name them."""
    found: dict[tuple, list[tuple[str, str]]] = {}
    for path in sorted(CORE.rglob("*.py")):
        module = ".".join(path.relative_to(CORE.parent).with_suffix("").parts).removesuffix(".__init__")
        for name, docstring in _docstrings(path):
            for kind, numbers in _REFERENCE.findall(" ".join(docstring.split())):
                place = f"{module}.{name}" if name else module
                for number in _numbers(numbers):
                    entry = (docstring.split("\n")[0].strip(), place)
                    rows = found.setdefault((kind.rstrip("s"), number), [])
                    if entry not in rows:
                        rows.append(entry)
    lines = [
        "# Equations",
        "",
        "Made from the docstrings that name an equation or a table of the thesis. The symbols are those of "
        "[the model](model.md). Misprints: `puma-sim thesis errata`.",
    ]
    for what in ("equation", "table"):
        lines += ["", f"## {what.capitalize()}s of the thesis", "", "| number | computed by | what it is |"]
        lines += ["|---|---|---|"]
        for (kind, number), rows in sorted(found.items(), key=lambda item: _order(item[0][1])):
            if kind == what:
                lines += [f"| {number} | `{place}` | {_cell(summary)} |" for summary, place in rows]
    return "\n".join(lines) + "\n"


def api_page() -> str:
    """Reference of the public names, module by module, as the stub lists them."""
    lines = ["# API reference", "", "The names of `import puma_sim_core as ps`. Each is imported at its first use.", ""]
    stub = ast.parse(Path(ps.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    named = [(node.module, alias) for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names]
    for module, aliases in itertools.groupby(named, key=lambda pair: pair[0]):
        lines += [f"## `{module}`", ""]
        for _, alias in aliases:
            public = alias.asname or alias.name
            value = getattr(ps, public)
            directive = "autoclass" if isinstance(value, type) else "autofunction"
            lines += [f"### `ps.{public}`", "", "```{eval-rst}"]
            lines += [f".. {directive}:: {module}.{alias.name}"]
            lines += ["   :members:"] if directive == "autoclass" and not issubclass(value, tuple) else []
            lines += ["```", ""]
    return "\n".join(lines)


def measures_table() -> str:
    """One table for each group of measures, which `measures.md` includes."""
    lines = []
    for group, members in itertools.groupby(MEASURES.values(), key=lambda measure: measure.group):
        lines += [f"### Measures of group {group}", "", "| measure | unit | definition | source |", "|---|---|---|---|"]
        lines += [f"| `{m.name}` | {m.unit} | {_cell(m.definition)} | {_cell(m.source)} |" for m in members]
        lines.append("")
    return "\n".join(lines)


def _docstrings(path: Path):
    """(qualified name, docstring) of a module and of all that it defines."""

    def walk(node, prefix):
        for child in ast.iter_child_nodes(node):
            if isinstance(child, (ast.FunctionDef, ast.ClassDef)):
                name = f"{prefix}{child.name}"
                yield name, ast.get_docstring(child) or ""
                yield from walk(child, f"{name}.")

    tree = ast.parse(path.read_text(encoding="utf-8"))
    yield "", ast.get_docstring(tree) or ""
    yield from walk(tree, "")


def _numbers(text: str) -> list[str]:
    """["7.5", "7.6", "7.7"] of "7.5 to 7.7"."""
    numbers = re.findall(r"\d\.\d+", text)
    if " to " not in text:
        return numbers
    return [f"{numbers[0]} to {numbers[-1]}"]


def _order(number: str) -> tuple:
    return tuple(int(part) for part in re.findall(r"\d+", number))


def _anchor(name: str) -> str:
    return "effect-" + name.replace("_", "-")


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("*", "\\*").replace("\n", " ")


def _literal(text: str) -> list[str]:
    return ["```text", text, "```"]


def setup(app):
    """Write the pages before Sphinx reads its sources."""

    def write(_app):
        pages = {
            "effects": effects_page,
            "equations": equations_page,
            "api": api_page,
            "measures_table": measures_table,
            "mechanism_numbers": mechanism_numbers_page,
        }
        for name, page in pages.items():
            path, text = DOCS / f"{name}.md", page()
            if not path.exists() or path.read_text(encoding="utf-8") != text:
                path.write_text(text, encoding="utf-8")

    app.connect("builder-inited", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
