"""The pages, and their code blocks and commands, as their readers would take them."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
LOG = ROOT / "docs" / "log.md"  # tells of what is gone, too
PAGES = sorted(
    [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
    + [page for page in (ROOT / "docs").rglob("*.md") if page != LOG]
)
NOTEBOOK = ROOT / "docs" / "projection_in_ten_minutes.ipynb"
_FENCE = re.compile(
    r"^(?P<indent> *)```(?P<language>\w*)\n(?P<text>.*?)^ *```$", flags=re.M | re.S
)


def list_blocks(language: str) -> Iterator[tuple[Path, str]]:
    """(page, text) of each fenced block in a language."""
    for page in PAGES:
        for match in _FENCE.finditer(page.read_text(encoding="utf-8")):
            if match["language"] == language:
                indent = re.compile(f"^{match['indent']}", flags=re.M)
                yield page, indent.sub("", match["text"])


def list_spans(page: Path) -> list[str]:
    """What a page quotes in backticks, outside of its blocks."""
    text = _FENCE.sub("", page.read_text(encoding="utf-8"))
    return [" ".join(span.split()) for span in re.findall(r"`([^`]+)`", text)]


def list_commands() -> list[tuple[str, list[str]]]:
    """(page, words) of each command; of each choice, as in quick|full, one."""
    commands = [
        (page.name, line)
        for page, text in list_blocks("sh")
        for line in text.replace("\\\n", " ").splitlines()
    ]
    begins = ("python -m dpc_jax.", "dpc_jax ", "launch/", "tests/", "--config")
    commands += [
        (page.name, span)
        for page in PAGES
        for span in list_spans(page)
        if span.startswith(begins) and not re.search(r"\*|FILE|SECTION", span)
    ]
    return [
        (page, [word.strip("[]") for word in words])
        for page, line in commands
        for words in _spread(shlex.split(line, comments=True))
        if words
    ]


def _spread(words: list[str]) -> list[list[str]]:
    for position, word in enumerate(words):
        if "|" in word:
            flag, equals, choices = word.rpartition("=")
            return [
                [*words[:position], flag + equals + choice, *words[position + 1 :]]
                for choice in choices.split("|")
            ]
    return [words]
