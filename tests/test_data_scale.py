"""The measurement of a data set at scale, on a small one."""

from dpc_jax.data import DataSpec
from dpc_jax.measure import data_growth


def test_it_measures_every_stage_and_mends_what_it_broke(tmp_path, capsys):
    spec = DataSpec("car", models=9, views=4, image_size=16, supersample=2)
    rows = dict(data_growth._measure(spec, cache_dir=tmp_path, processes=1))
    assert rows["models prepared"].startswith("9 in")
    assert "equal: True" in rows["a damaged shard made again"]
    assert "in 4 files" in rows["disk"] and "3 in an epoch" in rows["a batch"]
    assert "shard-00000.npz" in capsys.readouterr().out
    again = dict(data_growth._measure(spec, cache_dir=tmp_path, processes=1))
    assert "models prepared" not in again and "disk" in again


def test_the_command_prints_a_table_and_refuses_in_a_sentence(tmp_path, capsys):
    arguments = ["--models=4", "--views=4", "--image_size=16", "--processes=1"]
    assert data_growth.main([*arguments, f"--cache_dir={tmp_path}"]) == 0
    assert "| models per second |" in capsys.readouterr().out
    assert data_growth.main(["--models=0", f"--cache_dir={tmp_path}"]) == 1
    assert "models must be in" in capsys.readouterr().err
