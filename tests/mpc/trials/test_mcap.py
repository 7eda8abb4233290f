"""Runs survive as MCAP files."""

import json

import numpy as np

from allocator import BAR, DEG
from allocator.files.bags import Quantity, read_topics
from allocator.joint.antagonist import report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Plant, Run
from mpc.trials.files import save_mcap

PLANT = Plant(report_joint(SAROSI_DMSP_20_400N))


def some_run(n=20):
    t = 0.01 * np.arange(n)
    x = np.stack([0.1 * np.sin(t), 0.1 * np.cos(t), 2 * BAR + t * BAR, 2 * BAR - t * BAR], axis=1)
    K_ref = np.where(t < 0.05, np.nan, 6.0)
    zeros, whole = np.zeros(n - 1), np.zeros(n - 1, int)
    estimate = np.concatenate([x, np.zeros((n, 1))], axis=1)[:-1]
    moved = np.zeros((n - 1, 3))
    return Run(
        PLANT, 0.01, t, x, estimate, x[:-1, 2:], x[:, 0], K_ref, *PLANT.along(x),
        zeros, whole, whole, zeros, zeros, moved, "",
    )  # fmt: skip


def test_a_run_comes_back_from_its_mcap_file(tmp_path):
    run = some_run()
    save_mcap(run, tmp_path / "run.mcap")
    wanted = "theta=/joint.theta_deg:deg pressure1=/joint.P1_bar:bar"
    found = read_topics(tmp_path / "run.mcap", Quantity.parse(wanted))
    np.testing.assert_allclose(found["theta"][0], run.t, atol=1e-9)
    np.testing.assert_allclose(found["theta"][1], run.theta / DEG)
    np.testing.assert_allclose(found["pressure1"][1], run.P[:, 0] / BAR)


def test_messages_are_json_of_the_schema_and_without_nan(tmp_path):
    from mcap.reader import make_reader

    save_mcap(some_run(), tmp_path / "run.mcap")
    with (tmp_path / "run.mcap").open("rb") as stream:
        rows = [
            (schema, channel, json.loads(message.data))
            for schema, channel, message in make_reader(stream).iter_messages()
        ]
    schema, channel, first = rows[0]
    assert (channel.topic, channel.message_encoding, schema.encoding) == ("/joint", "json", "jsonschema")
    assert "K_ref" not in first
    assert set(rows[-1][2]) == set(json.loads(schema.data)["properties"])
