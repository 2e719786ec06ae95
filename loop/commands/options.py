"""What several commands share: exit codes and options."""

from typing import Annotated, Literal

from cyclopts import Parameter

OK, DIFFERS, FAILED, UNREAD, WRONG, INTERRUPTED = 0, 1, 1, 1, 2, 130

Keys = Annotated[list[str] | None, Parameter(consume_multiple=True, negative=())]
AllowCode = Annotated[bool, Parameter(negative=(), help="Run Python modules that files name; for files and modules that you trust.")]
Flag = Annotated[bool, Parameter(negative=())]
Json = Flag
Device = Literal["auto", "cpu", "cuda"]
