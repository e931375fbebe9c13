"""The page of reference: every module of envs, by autodoc. Docstrings are plain text, so they are translated first."""

import pkgutil

import plain_text
from sphinx.application import Sphinx

import envs

UNTOLD = ("__main__",)
SECTION = """

## `{name}`

```{{eval-rst}}
.. automodule:: {name}
   :members:
   :ignore-module-all:
   :show-inheritance:
```
"""


def modules() -> list[str]:
    """The names of all modules of envs, the package first."""
    found = [info.name for info in pkgutil.walk_packages(envs.__path__, "envs.")]
    return ["envs", *sorted(name for name in found if not name.endswith(UNTOLD))]


def write_modules(app: Sphinx, docname: str, source: list[str]) -> None:
    """Adds a section for each module."""
    if docname == "reference":
        source[0] += "".join(SECTION.format(name=name) for name in modules())


def translate(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Makes of a docstring in plain text what autodoc reads."""
    lines[:] = plain_text.to_restructured_text(plain_text.parse("\n".join(lines)))


def setup(app: Sphinx) -> dict:
    """Called by Sphinx."""
    app.connect("source-read", write_modules)
    app.connect("autodoc-process-docstring", translate)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
