# SPDX-License-Identifier: Apache-2.0
"""The runs of a campaign as Parquet."""

import json

import pytest

from ftcm_core import campaign
from ftcm_core.campaign import Campaign, parse_variation

parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("parquet")
    wanted = Campaign(
        "paper",
        runs=3,
        overrides=("duration=0.02", "transient=0.005"),
        variations=(
            parse_variation("observer.k1=uniform(10000, 20000)"),
            parse_variation("seed=integer(0, 9)"),
            parse_variation("torque_limits=choice(null, [97.6, 186.4, 89.4])"),
        ),
        controllers=("ftcm", "smc"),
    )
    campaign.run_campaign(wanted, engine="plain", jobs=1, folder=path)
    return path


def test_one_row_per_run_with_flat_columns(folder):
    runs = list(campaign.read_runs(folder / "runs.jsonl"))
    rows = parquet.read_table(folder / "runs.parquet").to_pylist()
    assert len(rows) == 6
    for row, run in zip(rows, runs):
        assert [row[k] for k in ("run", "contender", "status")] == [
            run[k] for k in ("run", "contender", "status")
        ]
        assert row["vary.observer.k1"] == float(run["set"][-3].partition("=")[2])
        assert row["vary.seed"] == int(run["set"][-2].partition("=")[2])
        assert row["vary.torque_limits"] == run["set"][-1].partition("=")[2]
        assert row["whole.mean_abs_error.joint2"] == run["metrics"]["whole"]["mean_abs_error"][1]
        assert row["whole.settling_time.joint1"] is None, "it does not settle"
        assert row["after_fault.mean_abs_error.joint1"] is None, "there is no such window"


def test_units_and_campaign_are_in_the_schema(folder):
    schema = parquet.read_schema(folder / "runs.parquet")
    assert schema.field("whole.mean_abs_error.joint1").metadata == {b"unit": b"rad"}
    assert schema.field("whole.torque_peak.joint3").metadata == {b"unit": "N·m".encode()}
    about = json.loads(schema.metadata[b"ftcm"])
    assert about["campaign"]["vary"]["seed"] == "integer(0, 9)"


@pytest.mark.parametrize("reader", ["pandas", "polars"])
def test_others_read_it(folder, reader):
    library = pytest.importorskip(reader, reason=f"{reader} is not installed")
    frame = library.read_parquet(folder / "runs.parquet")
    assert frame.shape[0] == 6
    assert frame["whole.mean_abs_error.joint1"].dtype in ("float64", getattr(library, "Float64", None))


def test_without_pyarrow_the_other_files_are_there(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    campaign.run_campaign(
        Campaign("paper", runs=1, overrides=("duration=0.02",)), engine="plain", jobs=1, folder=tmp_path
    )
    assert {p.name for p in tmp_path.iterdir()} == {"campaign.json", "runs.jsonl", "summary.json", "table.md"}
