"""Extension of griffe, which reads docstrings for the reference: a section `Example:` is shown as code with its output."""

import re
from typing import Any

import griffe


class Examples(griffe.Extension):
    """Name the section as griffe's parser of sections does."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Change the name of the section in the docstring of each object."""
        if obj.docstring is not None:
            obj.docstring.value = re.sub(r"^Example:$", "Examples:", obj.docstring.value, flags=re.MULTILINE)
