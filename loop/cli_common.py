"""What several commands share: exit codes and options."""

from typing import Annotated, Literal

from cyclopts import Parameter

OK, DIFFERS, UNREAD, WRONG, INTERRUPTED = 0, 1, 1, 2, 130

Keys = Annotated[list[str] | None, Parameter(consume_multiple=True, negative=())]
Json = Annotated[bool, Parameter(negative=())]
Device = Literal["auto", "cpu", "cuda"]
