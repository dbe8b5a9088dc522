"""Generated blocks of a page: made again by `graspcascade report`, while all text outside them stays.

A block stands between two comments::

    <!-- generated: name -->
    ...
    <!-- end -->
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from ..errors import check_name

_BLOCK = re.compile(r"(<!-- generated: (\S+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)


def fill_blocks(text: str, makers: Mapping[str, Callable[[], str]]) -> str:
    """Make the blocks of a page's text again, each by the maker of its name.

    Raises:
        InputError: a block of a name that nothing is made for.
    """

    def block(match: re.Match[str]) -> str:
        begin, name, _, end = match.groups()
        check_name("generated block", name, makers)
        return f"{begin}\n{makers[name]()}\n\n{end}"

    return _BLOCK.sub(block, text)
