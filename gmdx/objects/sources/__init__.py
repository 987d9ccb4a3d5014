"""Where objects come from: `resolve` turns what a user names into mesh files with stable ids.

One module a kind of source, in the table of `registry`. A new kind is a module with `NAME`,
`KNOWN_AS` and `expand`, and a place in that table.
"""

from gmdx.objects.sources.bundled import bundled_names
from gmdx.objects.sources.files import file_source
from gmdx.objects.sources.registry import resolve
from gmdx.objects.sources.source import ObjectSource

__all__ = [
    "ObjectSource",
    "bundled_names",
    "file_source",
    "resolve",
]
