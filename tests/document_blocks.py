"""The code blocks and commands of the pages, as their readers would take them."""

import importlib
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
    + [path for path in (ROOT / "docs").rglob("*.md")]
)
# A comment right before a block says why no test runs it.
_NOT_RUN = re.compile(r"<!-- not run: (.+?) -->", flags=re.DOTALL)
_FENCE = re.compile(r"^(?P<indent> *)```(?P<language>.*)$")


class Block(NamedTuple):
    """A fenced block of a page."""

    page: Path
    line: int  # of its first line of code, from 1
    language: str  # "" where none is given
    text: str
    reason: str  # why it is not run; "" where it is

    @property
    def name(self) -> str:
        """For the names of tests, as data.md:17."""
        return f"{self.page.name}:{self.line}"


class Command(NamedTuple):
    """A command of a shell block, or one quoted in a line of text."""

    name: str
    words: list[str]
    is_whole: bool  # not a part of a command, as a flag alone


def list_blocks(*languages: str) -> list[Block]:
    """The blocks of all pages in these languages."""
    blocks = [block for page in PAGES for block in _read_blocks(page)]
    return [block for block in blocks if block.language in languages]


def list_commands() -> list[Command]:
    """The commands of all pages; each alternative (quick|cpu) is a command."""
    commands = []
    for block in list_blocks("sh"):
        for words in [] if block.reason else split_commands(block.text):
            commands.append(Command(block.name, words, True))
    for page in PAGES:
        commands += _list_quoted(page)
    return [
        Command(command.name, words, command.is_whole)
        for command in commands
        for words in spread_choices(command.words)
    ]


def split_commands(text: str) -> list[list[str]]:
    """The words of each command of a shell block; what is optional is given."""
    text = text.replace("\\\n", " ")
    lines = [shlex.split(line, comments=True) for line in text.splitlines()]
    commands = []
    for words in filter(None, lines):
        commands.append([])
        for word in words:
            if word in ("&&", ";", "|"):
                commands.append([])
            else:
                commands[-1].append(word.strip("[]"))
    return commands


def spread_choices(words: list[str]) -> list[list[str]]:
    """--size=quick|full becomes two commands; a|b|c in one word alone."""
    for position, word in enumerate(words):
        if "|" in word:
            flag, equals, choices = word.rpartition("=")
            return [
                [*words[:position], flag + equals + choice, *words[position + 1 :]]
                for choice in choices.split("|")
            ]
    return [words]


def fill_in(word):
    """What a reader puts in the place of three dots or a single capital."""
    word = word.replace("--config=...", "--config=configs/car.py")
    return re.sub(r"=[A-Z]$", "=1", word)


def find_module(words):
    """(module, its arguments) of a command of this package, else None."""
    first, *rest = words
    if first in ("python", ".venv/bin/python"):
        assert rest[0] == "-m", words
        return rest[1], rest[2:]
    if first == "dpc_jax" and not rest[0].startswith("-"):
        commands = importlib.import_module("dpc_jax.commands").COMMANDS
        return commands[rest[0]].module.removesuffix(".__main__"), rest[1:]
    if first == "launch/run.sh":
        return "dpc_jax.main", rest
    if first == "launch/data.sh":
        return "dpc_jax.data", rest
    if first == "launch/seeds.sh":
        return "dpc_jax.main", [f"--config={rest[0]}", *rest[1:]]
    if first == "launch/hosts.sh":
        assert re.fullmatch(r"\d+|[\w.,]+", rest[0])
        return "dpc_jax.main", rest[1:]
    if first == "sbatch":
        position = rest.index("launch/slurm.sbatch")
        return "dpc_jax.main", [f"--config={rest[position + 1]}", *rest[position + 2 :]]
    return None


def read_text(page: Path) -> str:
    """A page without its blocks, line by line as it was."""
    inside, lines = False, []
    for line in page.read_text(encoding="utf-8").splitlines():
        is_fence = bool(_FENCE.match(line))
        inside ^= is_fence
        lines.append("" if inside or is_fence else line)
    return "\n".join(lines)


def list_spans(page: Path) -> Iterator[tuple[int, str]]:
    """(line, text) of what a page quotes in backticks."""
    text = read_text(page)
    for match in re.finditer(r"(?<!`)`([^`]+)`(?!`)", text):
        yield text.count("\n", 0, match.start()) + 1, " ".join(match[1].split())


def _list_quoted(page: Path) -> Iterator[Command]:
    begins = (
        "python -m dpc_jax",
        "dpc_jax ",
        ".venv/bin/python",
        "launch/",
        "--config",
    )
    for line, span in list_spans(page):
        if span.startswith(begins) and "*" not in span:
            (words, *_) = split_commands(span)
            is_whole = not span.startswith("--config") and len(words) > 1
            yield Command(f"{page.name}:{line}", words, is_whole)


def _read_blocks(page: Path) -> Iterator[Block]:
    lines = page.read_text(encoding="utf-8").splitlines()
    start, opened = 0, None
    for number, line in enumerate(lines):
        fence = _FENCE.match(line)
        if fence and opened is None:
            start, opened = number + 1, fence
        elif fence and opened is not None:
            indent = len(opened["indent"])
            text = "\n".join(code[indent:] for code in lines[start:number])
            above = "\n".join(lines[: start - 1]).rstrip()
            found = re.search(r"<!--(?:(?!-->).)*-->\Z", above, flags=re.DOTALL)
            reason = _NOT_RUN.fullmatch(found[0]) if found else None
            words = " ".join(reason[1].split()) if reason else ""
            yield Block(page, start + 1, opened["language"].strip(), text, words)
            opened = None
