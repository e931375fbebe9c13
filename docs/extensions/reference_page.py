"""The page of reference: a public name, its signature and its docstring, set like the docstrings of all pages."""

import importlib
import inspect
import re
from typing import Any

import plain_text
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


class Public(SphinxDirective):
    """A public name. Arguments: its full name, such as envs.make, and methods of it that are public, too."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        full, *methods = self.arguments[0].split()
        module, _, name = full.rpartition(".")
        thing = getattr(importlib.import_module(module), name)
        found = self.entry(full, thing)
        for method in methods:
            found += self.entry(f"{name}.{method}", getattr(thing, method))
        return found

    def entry(self, name: str, thing: Any) -> list[nodes.Node]:
        """Signature and docstring."""
        signature = str(inspect.signature(thing)) if inspect.isroutine(thing) else ""
        signature = re.sub(r"(: |-> )'([^']+)'", r"\1\2", signature)  # types without their quotes
        kind = "class" if inspect.isclass(thing) else "method" if "." in thing.__qualname__ else "function"
        text = plain_text.to_markdown(inspect.getdoc(thing) or "")
        return self.parse_text_to_nodes(f"::::::{{py:{kind}}} {name}{signature}\n:no-index:\n\n{text}\n::::::")


def setup(app: Sphinx) -> dict:
    """Called by Sphinx."""
    app.add_directive("public", Public)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
