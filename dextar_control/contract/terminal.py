"""The package prints in one way: what users, files and bags say appears as it is, on a
terminal and in a file.

Nothing that is printed here is markup: brackets in a path are brackets. Control
characters, which could move the cursor or colour a terminal, appear as the pictures
that Unicode has of them. Where the output is no terminal, lines are as long as they
need to be, and a line now and then takes the place of progress bars.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
import warnings
from collections.abc import Iterator
from typing import IO, Literal

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TaskID,
)
from rich.progress import TextColumn as MarkupColumn
from rich.table import Column
from rich.text import Text

# Characters of a line where the output is no terminal: no table needs so many.
FILE_WIDTH = 4000
ColorSystem = Literal["auto", "standard", "256", "truecolor", "windows"]
# s between two lines about what is under way, where the output is no terminal.
LINE_PERIOD = 10.0
_PICTURES = {
    code: 0x2400 + code for code in range(0x20) if code not in (0x09, 0x0A)
} | {0x7F: 0x2421}
_PICTURES |= dict.fromkeys(range(0x80, 0xA0), 0xFFFD)
_ONE_LINE = _PICTURES | {0x09: 0x20, 0x0A: 0x240A}


def plain(text: object) -> str:
    """Return a text in one line, without control characters."""
    return str(text).translate(_ONE_LINE)


def title(*lines: object) -> Text:
    """Return a table's title, whose lines do not break where the table is narrower."""
    return Text(
        "\n".join(map(plain, lines)),
        style="table.title",
        no_wrap=True,
        overflow="ignore",
    )


def say(text: object) -> None:
    """Print one line on the error output."""
    print(plain(text), file=sys.stderr)


@contextlib.contextmanager
def spoken_warnings(command: str) -> Iterator[None]:
    """Print each warning once, as one line on the error output, when the block has
    ended.

    Nothing is printed where an error ends the block: its own line says what is damaged.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default", UserWarning)
        yield
    for text in dict.fromkeys(
        str(warning.message)
        for warning in caught
        if issubclass(warning.category, UserWarning)
    ):
        say(f"dextar {command}: {text}")


class Terminal(Console):
    """A console for texts that are no markup.

    Args:
        stderr: write to the error output.
        file, width, force_terminal, color_system: as of rich's Console.
    """

    def __init__(
        self,
        *,
        stderr: bool = False,
        file: IO[str] | None = None,
        width: int | None = None,
        force_terminal: bool | None = None,
        color_system: ColorSystem | None = "auto",
    ) -> None:
        super().__init__(
            stderr=stderr,
            file=file,
            width=width,
            force_terminal=force_terminal,
            color_system=color_system,
            markup=False,
            highlight=False,
            emoji=False,
        )
        if not self.is_terminal and width is None and "COLUMNS" not in os.environ:
            self.width = FILE_WIDTH

    def on_broken_pipe(self) -> None:
        """Leave a broken pipe to the caller; rich would end the process with code 1,
        which means that a run was no success.
        """
        raise  # it is called where the error is caught

    def render_str(self, text: str, **options: object) -> Text:
        """Do as rich does, without control characters in the text."""
        text = text.translate(_PICTURES)
        # The options are rich's, and handed on as they come; so are those of Steps.
        return super().render_str(text, **options)  # type: ignore[arg-type]  # rich's

    def working(self, text: str) -> Working:
        """Return a display of what is done, for as long as its context lasts."""
        return Working(self, text)


class TextColumn(MarkupColumn):
    """A column of a progress display whose texts are no markup."""

    def __init__(
        self, text_format: str, style: str = "none", table_column: Column | None = None
    ) -> None:
        super().__init__(
            text_format, style=style, markup=False, table_column=table_column
        )

    def render(self, task: Task) -> Text:
        """Do as rich does, without control characters in the text."""
        return Text(
            self.text_format.format(task=task).translate(_PICTURES),
            style=self.style,
            justify=self.justify,
        )


class Steps(Progress):
    """Progress bars on a terminal; elsewhere a line for each task every
    ``LINE_PERIOD``, and one at its end.

    Args:
        columns: of the display.
        console: to write to.
        transient: whether the display vanishes at its end; then a task's end is no line
            either.
    """

    def __init__(
        self, *columns: ProgressColumn, console: Terminal, transient: bool = False
    ) -> None:
        super().__init__(
            *columns,
            console=console,
            transient=transient,
            disable=not console.is_terminal,
        )
        self._transient = transient
        self._told: dict[TaskID, str] = {}
        self._since = time.monotonic()

    def add_task(self, description: str, *options: object, **fields: object) -> TaskID:
        """Do as rich does."""
        task = super().add_task(description, *options, **fields)  # type: ignore[arg-type]  # rich's
        self._tell(task)
        return task

    def update(self, task_id: TaskID, **changes: object) -> None:
        """Do as rich does."""
        super().update(task_id, **changes)  # type: ignore[arg-type]  # rich's
        self._tell(task_id)

    def advance(self, task_id: TaskID, advance: float = 1) -> None:
        """Do as rich does."""
        super().advance(task_id, advance)
        self._tell(task_id)

    def _tell(self, task_id: TaskID) -> None:
        if not self.disable:
            return
        if time.monotonic() - self._since >= LINE_PERIOD:
            self._since = time.monotonic()
            self._lines(self.tasks)
        elif self._tasks[task_id].finished and not self._transient:
            self._lines([self._tasks[task_id]])

    def _lines(self, tasks: list[Task]) -> None:
        for task in tasks:
            words = [
                _words(column, task)
                for column in self.columns
                if isinstance(column, ProgressColumn)
            ]
            line = "  ".join(filter(None, words))
            if line != self._told.get(task.id):
                self._told[task.id] = line
                self.console.print(line, soft_wrap=True)


class Working(Steps):
    """A display of what is done, without knowing how long it takes.

    Args:
        console: to write to.
        text: what is done.
    """

    def __init__(self, console: Terminal, text: str) -> None:
        super().__init__(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            console=console,
            transient=True,
        )
        self._task = self.add_task(text, total=None)

    def now(self, text: str) -> None:
        """Show what is done now."""
        self.update(self._task, description=text)


def _words(column: ProgressColumn, task: Task) -> str:
    """Return what a column shows as text; a bar shows none."""
    if isinstance(column, (BarColumn, SpinnerColumn)):
        return ""
    shown = column.render(task)
    return (shown.plain if isinstance(shown, Text) else str(shown)).strip()
