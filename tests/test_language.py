"""One language: error sentences of one form, public names with docstrings and types."""

import ast
from pathlib import Path

import pytest

import dpc_jax

ROOT = Path(dpc_jax.__file__).parent
FILES = sorted(path.relative_to(ROOT).as_posix() for path in ROOT.rglob("*.py"))
# What a user meets. A KeyError or a TypeError tells a developer of a wrong call.
FOR_USERS = {"ValueError", "OSError", "RuntimeError", "NonFiniteError"}


def parse(name):
    return ast.parse((ROOT / name).read_text(encoding="utf-8"))


def read_literal(node):
    """The text of a string or f-string, "{}" for what is put in; None for others."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(
            str(part.value) if isinstance(part, ast.Constant) else "{}"
            for part in node.values
        )
    return None


def list_messages(tree):
    """(line, text) of the messages that errors are raised with."""
    for node in ast.walk(tree):
        if not (isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call)):
            continue
        name = getattr(node.exc.func, "id", getattr(node.exc.func, "attr", ""))
        if name in FOR_USERS and len(node.exc.args) == 1:
            text = read_literal(node.exc.args[0])
            # What is mostly put in was made elsewhere.
            if text is not None and len(text.replace("{}", "")) > 20:
                yield node.lineno, text


def bases_of(node):
    return node.bases if isinstance(node, ast.ClassDef) else []


def list_public(tree):
    """Public functions and methods, and classes, of a module."""
    for node in tree.body:
        if getattr(node, "name", "_").startswith("_"):
            continue
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node
        # The protocol of data sources says once what each of them answers.
        is_source = any(ast.unparse(b).endswith("Source") for b in bases_of(node))
        if isinstance(node, ast.ClassDef) and not is_source:
            for inner in node.body:
                if isinstance(inner, ast.FunctionDef) and inner.name[0] != "_":
                    yield inner


@pytest.mark.parametrize("name", FILES)
def test_an_error_says_what_was_expected_what_came_and_what_to_do(name):
    for line, text in list_messages(parse(name)):
        where = f"{name}:{line}: {text}"
        assert ", but " in text, where
        assert "; " in text, where
        assert text.endswith((".", "{}")), where


@pytest.mark.parametrize("name", FILES)
def test_what_is_public_has_a_docstring_and_types(name):
    for node in list_public(parse(name)):
        where = f"{name}:{node.lineno}: {node.name}"
        assert ast.get_docstring(node), f"{where} has no docstring"
        if isinstance(node, ast.FunctionDef):
            arguments = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
            bare = [a.arg for a in arguments if a.annotation is None]
            assert not set(bare) - {"self", "cls"}, f"{where}: {bare} have no types"


@pytest.mark.parametrize("name", FILES)
def test_code_is_quoted_with_single_backticks(name):
    assert "``" not in (ROOT / name).read_text(encoding="utf-8")
