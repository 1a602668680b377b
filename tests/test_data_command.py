"""The command on sources that are damaged in part: what it says, and how it ends."""

import json

import pytest
from data_trees import write_photos, write_renders

from dpc_jax.data import __main__


def run(*arguments):
    return __main__.main([str(argument) for argument in arguments])


def test_what_is_left_out_is_told_by_name_with_its_file(tmp_path, capsys):
    for i, name in enumerate("abcd"):
        content, _ = write_photos(tmp_path / name, views=3, seed=i)
        (tmp_path / name / "transforms.json").write_text(json.dumps(content))
    (tmp_path / "b" / "transforms.json").write_text("{}")
    assert run("check", tmp_path) == 0
    out = capsys.readouterr().out
    assert "warning: 1 of 4 objects left out as unusable: b" in out
    assert f"{tmp_path}/b/transforms.json" in out


def test_published_renders_are_checked_with_the_views_they_have(tmp_path, capsys):
    folder = write_renders(tmp_path, ["one", "two", "three"])
    (folder / "02958343" / "two" / "render_2.png").unlink()
    assert run("check", folder) == 0
    out = capsys.readouterr().out
    assert "2 car models, 6 views" in out and "two" in out
    (folder / "02691156").mkdir()
    assert run("check", folder) == 1
    assert "add --category" in capsys.readouterr().err


@pytest.mark.parametrize("words", [[], ["chekc"], ["check"], ["show", ".", "--x"]])
def test_a_command_with_wrong_words_is_answered_by_one_sentence(words, capsys):
    with pytest.raises(SystemExit) as stopped:
        run(*words)
    error = capsys.readouterr().err
    assert stopped.value.code == 2
    assert error.startswith("Error: Expected a command") and error.count("\n") == 1


@pytest.mark.parametrize("text", ["{", "{}", "[]", '{"shards": []}', "\xff\x00"])
def test_a_damaged_record_of_a_set_is_named(tmp_path, capsys, text):
    (tmp_path / "spec.json").write_bytes(text.encode("latin-1"))
    for command in ("show", "check"):
        assert run(command, tmp_path) == 1
        error = capsys.readouterr().err
        assert str(tmp_path) in error and error.count("\n") == 1
