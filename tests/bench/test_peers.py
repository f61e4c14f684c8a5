"""What the peer comparison rests on: times at equal error, the periodic box, and a peer that cannot be had."""

import math

import numpy as np
import pytest

from taichi_eye.bench import peers
from taichi_eye.bench.peers import Run
from taichi_eye.proof.domains import periodic_box


def runs(*pairs):
    """Runs of 100 nodes and 10 steps with the (error, seconds) given."""
    return [Run(nodes=100, steps=10, seconds=seconds, error=error) for error, seconds in pairs]


def test_time_at_an_error_lies_on_the_line_between_two_runs():
    # seconds = error^-2
    series = runs((0.1, 1e2), (0.01, 1e4))
    assert peers.time_at(0.02, [series]) == pytest.approx(0.02**-2)
    assert peers.time_at(0.1, [series]) == pytest.approx(1e2) and peers.time_at(0.01, [series]) == pytest.approx(1e4)
    assert peers.time_at(0.5, [series]) == pytest.approx(1e2)
    assert math.isinf(peers.time_at(0.009, [series]))


def test_time_at_an_error_is_that_of_the_quickest_series_even_where_errors_grow():
    slow, lucky = runs((0.1, 10.0), (0.01, 100.0)), runs((0.03, 2.0), (0.05, 9.0))
    assert peers.time_at(0.03, [slow, lucky]) == pytest.approx(2.0)
    assert peers.time_at(0.1, [slow, lucky]) == pytest.approx(2.0)
    assert peers.time_at(0.01, [slow, lucky]) == pytest.approx(100.0)


def test_rows_hold_where_the_peer_takes_long_enough_and_say_who_does_not_get_there():
    mine, theirs = [runs((0.1, 0.1), (0.01, 1.0))], [runs((0.1, 0.5), (0.02, 50.0))]
    rows = {row.name: row for row in peers.compare("flow", mine, theirs, (0.1, 0.02, 0.01), 10.0)}
    assert rows["flow: quicker than PySPH at 10 % error"].value == pytest.approx(5.0)
    assert rows["flow: quicker than PySPH at 10 % error"].holds is False
    assert rows["flow: quicker than PySPH at 2 % error"].holds is True
    missing = rows["flow: quicker than PySPH at 1 % error"]
    assert missing.value is None and "PySPH does not reach it" in missing.note and missing.holds is None
    assert rows["flow: updates/s, taichi_eye"].value == pytest.approx(1e-6 * 1000 / 0.1)


def test_without_the_peer_the_part_is_one_row_that_says_why(monkeypatch):
    def nowhere(stage):
        raise peers.PeerMissing("pysph cannot be installed (no network)")

    monkeypatch.setattr(peers, "environment", nowhere)
    rows, figures = peers.measure(lambda text: None)
    assert [row.value for row in rows] == [None] and "no network" in rows[0].note and figures == []


def test_an_environment_that_cannot_be_made_is_a_missing_peer(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(peers.sys, "executable", str(tmp_path / "no-python"))
    with pytest.raises(peers.PeerMissing, match="cannot be installed"):
        peers.environment(lambda text: None)


@pytest.mark.parametrize("spacing", [0.1, 0.0707])
def test_the_periodic_box_has_every_node_once_and_every_image_outside(spacing):
    cloud, images = periodic_box(spacing)
    points = cloud.points
    assert (
        points[:, 0].min() >= 0.0
        and points[:, 0].max() < 1.0
        and points[:, 1].min() > -1.0
        and points[:, 1].max() <= 0.0
    )
    everyone = np.vstack([points, images.place])
    # shifted by a period either way the cloud falls on itself
    for shift in ((1.0, 0.0), (0.0, 1.0), (1.0, -1.0)):
        moved = points + shift
        near = moved[(np.abs(moved - (0.5, -0.5)) < 0.5 + 2.0 * spacing).all(1)]
        gap = np.linalg.norm(near[:, None] - everyone[None], axis=2).min(1)
        assert len(near) and gap.max() < 1e-12
    distance = np.linalg.norm(everyone[:, None] - everyone[None], axis=2) + np.eye(len(everyone))
    assert distance.min() > 0.5 * spacing
    np.testing.assert_allclose(images.sign, 1.0)
    shift = images.place - points[images.source]
    np.testing.assert_allclose(shift, np.rint(shift), atol=1e-12)


def test_both_flows_of_the_box_converge():
    box = peers._Box((0.0707, 0.05))
    for case, bound in (("taylor-green", 0.4), ("standing-wave", 0.06)):
        coarse, fine = box.run(case, 0.0707), box.run(case, 0.05)
        assert fine["error"] < bound and fine["error"] < 0.6 * coarse["error"]
        assert fine["nodes"] > 1.5 * coarse["nodes"] and fine["seconds"] > 0.0
