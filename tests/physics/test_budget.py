"""The paper's Table 1 and frame rates, re-derived, against the audited figures."""

import json
import time
from pathlib import Path

import numpy as np
import pytest
from scipy import constants, optimize

from twin import cli
from twin.budget import SENSORS, OpticalLink, audit, frame_rates, link_of
from twin.budget.link import (
    distance_sigma_m,
    implied_read_noise_e,
    maximum_distance_m,
    minimum_time_s,
    noise_e,
)
from twin.files import InputError
from twin.system import load_part, load_system

PAPER = load_system("paper")


def paper_link(name: str, **options: bool) -> OpticalLink:
    return link_of(PAPER, load_part(name), **options)


def test_areas_as_printed_and_as_they_are() -> None:
    """Square micrometres: the FGA015's 4 times, the G9201's pixel 20 times apart."""
    area = {name: load_part(name).detector.area_m2 * 1e12 for name in SENSORS}
    assert area["fga015"] == pytest.approx(17_671, abs=1)
    assert area["fga015-paper"] == pytest.approx(70_683, rel=1e-4)
    assert area["g9201-256"] == pytest.approx(12_500)
    assert area["g9201-256-paper"] == pytest.approx(625)
    assert area["g10768-1024d"] == pytest.approx(2_500)


def test_the_link_is_that_of_the_camera() -> None:
    """Same watts as the radiometry of the rendered chain, less its <cos^7>."""
    from twin.optics.radiometry import wall_power_w

    link = paper_link("fga015", whole_line=True)
    per_watt = 0.95 / constants.e
    expected = wall_power_w(PAPER, 0.8, 10.0) / 0.9319103673 * per_watt
    assert link.signal_e_per_s(0.8, 10.0) == pytest.approx(expected, rel=1e-9)


def test_a_link_takes_what_a_wall_can_be() -> None:
    """No light comes from nowhere: by the formula -5 m were as good as 5 m, and 0 m infinite."""
    link = paper_link("fga015")
    for distance_m in (-5.0, 0.0, np.nan, np.array([5.0, -1.0])):
        with pytest.raises(InputError, match=r"^distance_m: \S+ m, expected above 0$"):
            link.signal_e_per_s(0.5, distance_m)
    for reflectance in (-0.1, 2.0, np.nan, np.array([0.5, 1.5])):
        for call in (lambda rho: link.signal_e_per_s(rho, 5.0), link.background_e_per_s):
            with pytest.raises(InputError, match=r"^reflectance: \S+, expected 0 to 1$"):
                call(reflectance)
    assert np.all(link.signal_e_per_s(np.array([0.0, 1.0]), np.array([1e-3, 1e9])) >= 0)


def test_minimum_time_gives_the_snr_asked_for() -> None:
    rng = np.random.default_rng(0)
    signal, background, read = rng.lognormal(5, 4, (3, 1000))
    for snr in (1.0, 7.0):
        shortest = minimum_time_s(signal, background, read, snr)
        found = signal * shortest / noise_e(signal, background, shortest, read)
        np.testing.assert_allclose(found, snr, rtol=1e-9)
    assert minimum_time_s(0.0, 1.0, 1.0) == np.inf


def test_limits_of_the_minimum_time() -> None:
    """Photon-limited: (s + b) / s^2. Read-noise-limited: r / s."""
    assert minimum_time_s(1e6, 1e8, 0.0) == pytest.approx(1.01e8 / 1e12)
    assert minimum_time_s(1e6, 0.0, 1e9) == pytest.approx(1e3, rel=1e-5)


def test_distance_and_time_are_each_others_inverse() -> None:
    link = paper_link("g10768-1024d")
    for distance in (0.1, 3.0, 50.0):
        signal, background = link.signal_e_per_s(0.5, distance), link.background_e_per_s(0.5)
        needed = minimum_time_s(signal, background, 3e3)
        at_1_m = link.signal_e_per_s(0.5, 1.0)
        assert maximum_distance_m(at_1_m, background, needed, 3e3) == pytest.approx(distance)


def test_implied_read_noise_makes_the_time_just_enough() -> None:
    read = implied_read_noise_e(1e8, 1e9, 1e-3)
    assert minimum_time_s(1e8, 1e9, read) == pytest.approx(1e-3)
    assert implied_read_noise_e(1.0, 1e9, 1e-3) == 0.0


def test_distance_sigma_is_the_bound_of_a_sinusoids_phase() -> None:
    """Fisher information of 1 + m cos(phase) sampled densely, small m: N m^2 / 2 for N photons."""
    n, depth, f = 1e8, 0.05, 10e6
    phase = np.linspace(0, 2 * np.pi, 4096, endpoint=False)
    rate = 1 + depth * np.cos(phase)
    fisher = n * np.mean((depth * np.sin(phase)) ** 2 / rate)
    expected = constants.c / (4 * np.pi * f) / np.sqrt(fisher)
    assert distance_sigma_m(np.sqrt(n), f, depth) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("name", ["fga015", "g10768-1024d", "g9201-256-paper"])
def test_photons_alone_need_orders_of_magnitude_less_than_table_1(name: str) -> None:
    """Audited: three to five orders, the whole line inside the filter as the paper has it."""
    row = audit(paper_link(name, whole_line=True), load_part(name))
    ratio = row.printed_time_s / row.photon_limited_s
    assert (ratio > 2e2).all()
    assert ratio.max() > 1e3
    assert (ratio < 1e6).all()


@pytest.mark.parametrize(("name", "within"), [("fga015", 0.25), ("g10768-1024d", 0.42)])
def test_one_read_noise_follows_a_row(name: str, within: float) -> None:
    """Audited: T proportional to z^2 / rho follows within about 20 % and 40 %."""
    row = audit(paper_link(name, whole_line=True), load_part(name))
    assert np.abs(row.residual).max() < within
    np.testing.assert_allclose(np.log1p(row.residual).mean(), 0, atol=1e-3)


def test_table_1_is_too_short_for_its_centimetre() -> None:
    """At the printed times a reading has SNR near 1: metres of scatter at 10 MHz, not < 1 cm."""
    row = audit(paper_link("fga015", whole_line=True), load_part("fga015"))
    assert (row.distance_sigma_m > 1.0).all()


def test_elasticities_are_derivatives() -> None:
    """Of log T at the last cell, against a numerical derivative from SciPy."""
    part = load_part("fga015")
    link = paper_link("fga015")
    row = audit(link, part)

    def log_time(log_power: np.ndarray) -> float:
        changed = OpticalLink(**{**vars(link), "sun_w_per_m2": float(np.exp(log_power[0]))})
        signal = changed.signal_e_per_s(0.8, 10.0)
        rest = changed.background_e_per_s(0.8)
        return float(np.log(minimum_time_s(signal, rest, row.read_noise_e)))

    slope = optimize.approx_fprime(np.log([link.sun_w_per_m2]), log_time, 1e-5)[0]
    assert row.elasticity["sun_w_per_m2"] == pytest.approx(slope, rel=1e-3)
    assert list(row.elasticity.values()) == sorted(row.elasticity.values(), key=lambda v: -abs(v))


def test_frame_rates_are_the_audited_ones() -> None:
    """61.7 (not 65.8); 23.92 (not 24); differential 51.5, 31.1, 18.8 in turns, 24.8 overlapped."""
    fga = frame_rates(load_part("fga015"))
    assert [round(r.plain, 1) for r in fga] == [61.7, 44.2, 30.2]
    assert [round(r.differential, 1) for r in fga] == [51.5, 31.1, 18.8]
    assert fga[2].differential_overlapped == pytest.approx(24.8, abs=0.01)
    assert frame_rates(load_part("g10768-1024d"))[2].plain == pytest.approx(23.92, abs=0.01)


def test_the_line_rate_is_respected() -> None:
    """Asked for one line in 1 us, the G10768 still takes 1/39 000 s."""
    part = load_part("g10768-1024d")
    slow = part.model_copy(
        update={
            "detector": part.detector.model_copy(
                update={"line_rate_hz": type(part.detector.line_rate_hz)(value=1e3, source="test")}
            )
        }
    )
    assert frame_rates(slow, processing_s=1e-9)[0].plain == pytest.approx(1e3 / 64)


def test_a_million_designs_take_less_than_two_seconds() -> None:
    rng = np.random.default_rng(0)
    fields = rng.lognormal(0, 0.3, (8, 1_000_000))
    start = time.perf_counter()
    link = OpticalLink(*fields)
    signal, background = link.signal_e_per_s(0.5, 5.0), link.background_e_per_s(0.5)
    shortest = minimum_time_s(signal, background, 1e3)
    maximum_distance_m(link.signal_e_per_s(0.5, 1.0), background, 1e-3, 1e3)
    assert np.isfinite(shortest).all()
    assert time.perf_counter() - start < 2


def test_the_command_prints_and_writes(monkeypatch, capsys, tmp_path: Path) -> None:
    out = tmp_path / "b"
    monkeypatch.setattr("sys.argv", ["twin", "budget", "--out", str(out)])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    assert not stopped.value.code
    printed = capsys.readouterr().out
    for figure in ("61.7", "23.9", "51.5", "24.8"):
        assert figure in printed
    content = json.loads((out / "budget.json").read_text())
    assert {row["sensor"] for row in content["table1"]} == set(SENSORS)
    assert (out / "budget.png").stat().st_size > 10_000


def test_a_part_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "big.toml"
    path.write_text('base = "fga015"\n[detector]\nwidth_m = 3e-3\n')
    assert load_part(path).detector.area_m2 == pytest.approx(7.07e-6, rel=1e-3)
    path.write_text('base = "fga015"\n[detector]\nheight_m = 3e-3\n')
    with pytest.raises(InputError, match="width_m alone"):
        load_part(path)
