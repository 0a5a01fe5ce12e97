# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Pages from templates: one HTML file each, which needs no network and has no script."""

from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from puma_sim_core import __version__
from puma_sim_core.pages.drawing import svg
from puma_sim_core.pages.figure import COLOURS, legend
from puma_sim_core.pages.text import raised


def environment(package: str, **names: Any) -> Environment:
    """The templates of a package and those that all pages share; `names` are known in them."""
    found = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader("puma_sim_core.pages")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    found.filters["raised"] = raised
    found.globals.update(svg=svg, legend=legend, colours=COLOURS, version=__version__, zip=zip, **names)
    return found


def render(pages: Environment, template: str, **values: Any) -> str:
    """The page; what a file name has that is no text becomes a question mark."""
    return pages.get_template(template).render(values).encode("utf-8", "replace").decode("utf-8")
