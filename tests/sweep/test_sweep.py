"""Sweeps: what is varied arrives, renders are shared, kills lose nothing, workers do not matter."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import psutil
import pytest
import xarray
from studies import CLOSED, SMALL

from twin.camera import capture
from twin.camera.light import render
from twin.camera.reflectance_rescaling import render_unit_reflectance
from twin.fidelity import Fidelity
from twin.files import InputError
from twin.scene import load_scene
from twin.sweep import DamagedWarning, load_study, open_sweep, run_sweep
from twin.sweep.evaluate import evaluate_chunk, outcome_of
from twin.sweep.sensitivity import sensitivities
from twin.sweep.show import pareto_front, plot_front, plot_plane
from twin.sweep.store import Store
from twin.system import System, load_system
from twin.workers import SchedulerGoneError, dask


def test_grid_zip_and_sample_make_one_labelled_dataset(
    study, a_worker: str, tmp_path: Path
) -> None:
    path = study(
        '[grid]\n"system.sky.illuminance_lx" = [0, 1e4]\n'
        '[[zip]]\n"system.acquisition.integration_time_s" = ["50 us", "80 us", "0.1 ms"]\n'
        '"system.readout.read_noise_e" = [1e3, 2e3, 3e3]\n'
        '[sample]\nmethod = "sobol"\nn = 4\n'
        '[sample.ranges]\n"system.optics.f_number" = { low = 1.0, high = 4.0, log = true }\n'
    )
    summary = run_sweep(path, out=tmp_path / "out", scheduler=a_worker)
    data = open_sweep(tmp_path / "out")
    assert summary.n_points == 24
    assert summary.n_failed == 0
    assert dict(data.sizes) == {"system.sky.illuminance_lx": 2, "zip_0": 3, "sample": 4}
    times = data["system.acquisition.integration_time_s"]
    np.testing.assert_allclose(times, [50e-6, 80e-6, 100e-6], rtol=1e-12)
    assert times.attrs["units"] == "s"
    assert data["psnr_db"].attrs["units"] == "dB"
    assert np.isfinite(data["snr_median"]).all()
    # More sun, less signal to noise; a faster lens, more.
    snr = data["snr_median"].transpose("system.sky.illuminance_lx", "zip_0", "sample")
    assert (snr[1] < snr[0]).all()
    fast_first = np.argsort(data["system.optics.f_number"].to_numpy())
    assert (np.diff(snr.to_numpy()[:, :, fast_first], axis=-1) < 0).all()
    assert json.loads(data.attrs["study"])["scene"] == "table1"
    assert "mitsuba" in json.loads(data.attrs["versions"])


def test_a_point_is_what_a_capture_gives(study) -> None:
    """The same counts, bit for bit, as `capture` with the same values set by hand and the study's
    seed; where reflectances are put in afterwards (depth 1) light is the same to float32's digits,
    which may round a count or two of the 512 otherwise. A seed that is varied is the capture's.
    """
    text = '[grid]\n"system.detector.width_m" = ["2 mm"]\n"seed" = [3, 5]\n'
    for depth in (1, 2):
        head = SMALL.replace('max_depth" = 1', f'max_depth" = {depth}')
        for index, seed in enumerate((3, 5)):
            outcome = outcome_of(load_study(study(text, head)), index)
            made = outcome.setup
            assert made.system.detector.width_m.value == pytest.approx(2e-3)
            by_hand = capture(made.scene, made.system, fidelity=made.fidelity, seed=seed)
            found, expected = outcome.capture.record.counts, by_hand.record.counts
            np.testing.assert_allclose(found, expected, rtol=0, atol=1 if depth == 1 else 0)
            assert np.count_nonzero(found != expected) <= 5
            np.testing.assert_allclose(outcome.capture.scene_e, by_hand.scene_e, rtol=1e-6)


def test_reflectances_are_put_in_afterwards_without_another_render() -> None:
    """Light by object times reflectance is what a render of these gives: to float32's digits."""
    scene, system = load_scene("yard"), load_system("workable")
    fidelity = Fidelity(16, 1)
    seed = np.random.SeedSequence(3)
    unit = render_unit_reflectance(scene, system, fidelity=fidelity, seed=seed)
    from dataclasses import replace

    for factor in (1.0, 0.3):
        objects = tuple(
            replace(o, reflectance=o.reflectance * factor)
            if isinstance(o.reflectance, float) and o.name != "ground"
            else o
            for o in scene.objects
        )
        changed = replace(scene, objects=objects)
        expected = render(changed, system, fidelity=fidelity, seed=np.random.SeedSequence(3))
        found = unit.rescaled(changed)
        for a, b in (
            (found.light.cells, expected.light.cells),
            (found.sun, expected.sun),
            (found.truth.albedo, expected.truth.albedo),
        ):
            np.testing.assert_allclose(a, b, atol=1e-6 * b.max())
        np.testing.assert_array_equal(found.truth.depth_m, expected.truth.depth_m)
    with pytest.raises(ValueError, match="direct light"):
        render_unit_reflectance(scene, system, fidelity=Fidelity(4, 2), seed=seed)


def test_only_what_differs_optically_is_rendered(study) -> None:
    """3 detectors x 2 reflectances x 2 skies x 2 methods at 2 distances: 2 renders."""
    path = study(
        '[grid]\n"system.detector.width_m" = [1e-3, 2e-3, 3e-3]\n'
        '"scene.objects.*.reflectance" = [0.2, 0.8]\n"scene.rig.x_m" = [0.0, 0.5]\n'
        '"system.sky.illuminance_lx" = [0, 400]\n"processing.method" = ["zero-fill", "lmmse"]\n'
    )
    plan = load_study(path)
    chunk = evaluate_chunk(plan, 0, plan.n_points)
    assert plan.n_points == 48
    assert not chunk.errors
    assert chunk.renders == 2


def test_reflectance_moves_the_signal_in_proportion(study) -> None:
    path = study('[grid]\n"scene.objects.*.reflectance" = [0.0, 0.2, 0.4]\n').read_text()
    study(path.replace('"psnr_db"', '"signal_e"'), head="")
    plan = load_study(study(path.replace('"psnr_db"', '"signal_e"'), head=""))
    signal = evaluate_chunk(plan, 0, 3).values["signal_e"]
    assert signal[0] == 0
    assert signal[2] == pytest.approx(2 * signal[1], rel=1e-9)


def assert_is_what_one_process_gives(found: xarray.Dataset, path: Path) -> None:
    """Every figure of a sweep, bit for bit: its points in order, in this process, no worker."""
    plan = load_study(path)
    here = evaluate_chunk(plan, 0, plan.n_points)
    assert not here.errors
    for name, values in here.values.items():
        np.testing.assert_array_equal(found[name].to_numpy().ravel(), values)


@pytest.mark.thorough
def test_results_do_not_depend_on_workers(study, tmp_path: Path) -> None:
    text = '[grid]\n"scene.rig.x_m" = [0.0, 0.2, 0.4, 0.6]\n"system.readout.read_noise_e" = '
    text += f"{[float(n) for n in range(1, 13)]}\n"
    run_sweep(study(text), out=tmp_path / "out", workers=2)
    assert_is_what_one_process_gives(open_sweep(tmp_path / "out"), study(text))
    run_sweep(study(text), out=tmp_path / "one", workers=0)
    many, one = (contents(tmp_path / name / "results.zarr") for name in ("out", "one"))
    assert len(one) > 5
    assert many == one


def contents(folder: Path) -> dict[str, bytes]:
    """Of all files, by their paths within."""
    files = [file for file in folder.rglob("*") if file.is_file()]
    return {str(file.relative_to(folder)): file.read_bytes() for file in files}


def test_a_failed_point_is_a_row_with_its_error(study, a_worker: str, tmp_path: Path) -> None:
    path = study('[grid]\n"system.detector.part" = ["fga015", "g10768-1024d"]\n')
    summary = run_sweep(path, out=tmp_path / "out", scheduler=a_worker)
    data = open_sweep(tmp_path / "out")
    assert summary.n_failed == 1
    assert np.isfinite(data["snr_median"][0])
    assert np.isnan(data["snr_median"][1])
    assert "line sensor" in str(data["error"].values[1])
    assert str(data["error"].values[0]) == ""


@pytest.mark.parametrize("name", ["mine:brightest", "mine.py:brightest"])
def test_a_users_own_metric_is_found_beside_the_study(study, tmp_path: Path, name: str) -> None:
    (tmp_path / "mine.py").write_text(
        "def brightest(outcome):\n"
        '    """Electrons of the brightest cell."""\n'
        "    return outcome.capture.cells_e.max()\n"
        'brightest.unit = "e"\n'
    )
    head = SMALL.replace('"psnr_db"', f'"{name}"')
    plan = load_study(study('[grid]\n"scene.rig.x_m" = [0.0]\n', head))
    chunk = evaluate_chunk(plan, 0, 1)
    assert not chunk.errors
    assert chunk.values[name][0] > 0


def snr_all_lit(
    system: System, reflectance: float, time_s: float | None = None, distance_m: float = 5.0
) -> float:
    """Of one exposure to a wall, all cells lit, from the light of `twin budget`, a mean exposure
    with half of the cells lit, and the noise of the simulated camera.
    """
    from twin.budget import wall_rows
    from twin.detector import FrontEnd, noise_budget

    (row,) = wall_rows(system, [distance_m], [reflectance])
    own = FrontEnd.of(system).electrons_per_watt
    if time_s is not None:
        exposure = system.acquisition.integration_time_s.model_copy(update={"value": time_s})
        copy = system.acquisition.unchecked_copy({"integration_time_s": exposure})
        system = system.unchecked_copy({"acquisition": copy})
    fluctuation = system.emitter.intensity_noise
    lit = noise_budget(
        np.array([2 * row.budget.signal_e / own]),
        row.budget.background_e / own,
        FrontEnd.of(system),
        fluctuation.value if fluctuation else 0.0,
    )
    return lit.signal_e / lit.total_noise_e


def test_closed_form_equals_the_budget_point_by_point(study, tmp_path: Path) -> None:
    """Arrays against one design at a time; an impossible point is a row with its error."""
    from twin.system import load_part

    path = study(
        '[grid]\n"link.distance_m" = [1.0, 5.0, 10.0]\n"link.reflectance" = [0.2, 0.8]\n'
        '"system.detector.part" = ["fga015", "g9201-256-paper"]\n'
        '"system.filter.width_m" = ["12 nm", "30 nm"]\n'
        '"system.acquisition.integration_time_s" = ["80 us", "1 s"]\n',
        CLOSED,
    )
    summary = run_sweep(path, out=tmp_path / "out")
    data = open_sweep(tmp_path / "out")
    assert summary.n_points == 48
    assert summary.n_failed == 24
    one = data.sel(
        {
            "link.distance_m": 5.0,
            "link.reflectance": 0.8,
            "system.detector.part": "fga015",
            "system.filter.width_m": 12e-9,
            "system.acquisition.integration_time_s": 80e-6,
        },
        method=None,
    )
    system = load_system("workable")
    narrow = system.filter.model_copy(
        update={"width_m": system.filter.width_m.model_copy(update={"value": 12e-9})}
    )
    system = system.model_copy(
        update={"filter": narrow, "detector": load_part("fga015").detector},
    )
    assert float(one["snr"]) == pytest.approx(snr_all_lit(system, 0.8), rel=1e-12)
    time_s = float(one["minimum_time_s"])
    assert snr_all_lit(system, 0.8, time_s) == pytest.approx(1, rel=1e-12)
    assert "expected at most pattern_period_s" in str(data["error"].values.ravel()[-1])


def test_what_is_of_noise_alone_says_so_beside_the_number(study, tmp_path: Path) -> None:
    """A sweep's labels, which are the titles of its pictures too."""
    path = study('[grid]\n"link.distance_m" = [1.0, 5.0]\n', CLOSED)
    run_sweep(path, out=tmp_path / "out")
    data = open_sweep(tmp_path / "out")
    for name in ("snr", "minimum_time_s", "maximum_distance_m"):
        assert "neither lag nor clipping is counted" in data[name].attrs["long_name"]
        title = plot_plane(data, name, "link.distance_m").axes[0].get_title()
        assert "neither lag nor clipping" in title


def test_a_hundred_thousand_points_of_the_closed_form_take_seconds(study, tmp_path: Path) -> None:
    path = study(
        '[sample]\nmethod = "latin-hypercube"\nn = 100000\n[sample.ranges]\n'
        '"link.distance_m" = { low = 1.0, high = 100.0, log = true }\n'
        '"system.optics.f_number" = { low = 1.0, high = 4.0 }\n'
        '"system.acquisition.integration_time_s" = { low = 1e-6, high = 1e-4, log = true }\n',
        CLOSED,
    )
    start = time.perf_counter()
    run_sweep(path, out=tmp_path / "out")
    assert time.perf_counter() - start < 20  # 5 s on an idle machine; see `make bench`
    data = open_sweep(tmp_path / "out")
    assert np.isfinite(data["snr"]).all()
    assert data["link.distance_m"].min() >= 1
    # Also of points that are void at their own distance: near ones are that more often.
    moved = sensitivities(data, "maximum_distance_m", void=True)
    time_share = moved["system.acquisition.integration_time_s"]
    # A farthest distance knows no distance.
    assert time_share.first > 0.5 > moved["link.distance_m"].first_error
    assert abs(moved["link.distance_m"].first) < moved["link.distance_m"].first_error


@pytest.mark.thorough
def test_numbers_of_a_system_are_arrays_too(study, tmp_path: Path) -> None:
    """A quarter of a million systems, no two alike, in seconds (one by one: a minute and more), and
    each is what the budget gives for it alone: to the rounding of a sum of spectra.
    """
    from twin.sweep.inputs import inputs_of
    from twin.sweep.setup import system_of

    path = study(
        '[sample]\nmethod = "latin-hypercube"\nn = 262144\n[sample.ranges]\n'
        '"system.filter.width_m" = { low = 5e-9, high = 80e-9 }\n'
        '"system.filter.center_wavelength_m" = { low = 1.5e-6, high = 1.6e-6 }\n'
        '"system.emitter.peak_wavelength_m" = { low = 1.54e-6, high = 1.56e-6 }\n'
        '"system.emitter.line_fwhm_m" = { low = 1e-9, high = 1e-7, log = true }\n'
        '"system.detector.width_m" = { low = 1e-4, high = 3e-3 }\n'
        '"system.sky.illuminance_lx" = { low = 0.0, high = 1e5 }\n',
        CLOSED,
    )
    plan, start = load_study(path), time.process_time()
    run_sweep(path, out=tmp_path / "out")
    assert time.process_time() - start < 30  # 2 s on an idle machine
    found = open_sweep(tmp_path / "out")["snr"].to_numpy()
    inputs = inputs_of(plan)
    for index in (0, 1234, 262143):
        system = system_of(plan, plan.point(index), inputs)
        expected = snr_all_lit(system, 0.5)
        assert found[index] == pytest.approx(expected, rel=1e-10)


def test_curves_are_integrated_for_each_wavelength(study, tmp_path: Path) -> None:
    """Behind a vendor's curve a line's place counts by itself: half way down the curve's edge the
    share is that of its transmission, 0.4 at 1550 nm and 0.2 at 1575 nm for a narrow line.
    """
    (tmp_path / "edge.csv").write_text("nm,T\n1500,0.8\n1600,0.0\n")
    path = study(
        '[set]\n"system.filter.transmission_csv" = "edge.csv"\n'
        '"system.emitter.line_fwhm_m" = 1e-9\n'
        '"system.filter.effective_index" = 1e3\n'  # it shifts with no angle
        '[grid]\n"system.emitter.peak_wavelength_m" = [1550e-9, 1575e-9]\n'
        '"system.optics.transmission" = [0.9, 0.45]\n',
        CLOSED.replace('"snr"', '"signal_e_per_s"'),
    )
    run_sweep(path, out=tmp_path / "out")
    data = open_sweep(tmp_path / "out")["signal_e_per_s"]
    signal = data.transpose("system.emitter.peak_wavelength_m", "system.optics.transmission")
    relative = signal.to_numpy() / float(signal[0, 0])
    np.testing.assert_allclose(relative, [[1.0, 0.5], [0.5, 0.25]], rtol=1e-6)


@pytest.mark.parametrize(
    "kills_tried",
    [pytest.param(2, marks=pytest.mark.whole), pytest.param(50, marks=pytest.mark.slow)],
)
def test_kill_and_resume_give_the_same_bits(
    study, a_worker: str, tmp_path: Path, kills_tried: int
) -> None:
    """Killed at random moments, SIGKILL, then resumed until done."""
    text = f'[grid]\n"scene.rig.x_m" = {[i / 10 for i in range(8)]}\n'
    noises = 32 if kills_tried == 2 else 1024
    text += f'"system.readout.read_noise_e" = {[float(n) for n in range(1, noises + 1)]}\n'
    path = study(text)
    out, rng, kills = tmp_path / "killed", np.random.default_rng(0), 0
    command = [sys.executable, "-m", "twin", "sweep", str(path), "--out", str(out)]
    command += ["--workers", "1"]
    for _ in range(kills_tried):
        process = subprocess.Popen(
            command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        try:
            while process.poll() is None and not (out / "study.json").is_file():
                time.sleep(0.02)
            process.wait(timeout=float(rng.uniform(0.0, 4.0)))
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            kills += 1
        if (out / "study.json").is_file():
            assert open_sweep(out).attrs["points"] == 8 * noises  # readable at any time
    with (out / "journal.jsonl").open("a") as journal:
        journal.write('{"start": 11')  # a line that a kill cut off
    run_sweep(path, out=out, scheduler=a_worker)
    assert kills >= 1
    assert_is_what_one_process_gives(open_sweep(out), path)


def test_numbers_that_were_cut_short_are_computed_again(study, tmp_path: Path) -> None:
    """Mapped for writing, a file grows back to its length by zeros, which look like results."""
    path = study('[grid]\n"link.distance_m" = [1.0, 2.0, 4.0]\n', CLOSED)
    run_sweep(path, out=tmp_path / "out")
    whole = open_sweep(tmp_path / "out").load()
    numbers = tmp_path / "out" / "points" / "snr.npy"
    length = numbers.stat().st_size
    for size in (0, 100, length - 8):
        os.truncate(numbers, size)
        with pytest.warns(DamagedWarning, match=r"snr\.npy: is damaged .* of 3 points from 0 on"):
            run_sweep(path, out=tmp_path / "out")
        assert numbers.stat().st_size == length
        assert open_sweep(tmp_path / "out").identical(whole)


@pytest.mark.parametrize(
    "line", [b"\xff\x00\x93", b"[1]", b"7", b'{"start": 0, "stop": 3}', b"\0\0"]
)
def test_a_damaged_line_of_the_journal_is_computed_again(
    study, tmp_path: Path, line: bytes
) -> None:
    path = study('[grid]\n"link.distance_m" = [1.0, 2.0, 4.0]\n', CLOSED)
    run_sweep(path, out=tmp_path / "out")
    whole = open_sweep(tmp_path / "out").load()
    (tmp_path / "out" / "journal.jsonl").write_bytes(line + b"\n")
    with pytest.warns(DamagedWarning, match=r"journal\.jsonl: is damaged in line 1: "):
        run_sweep(path, out=tmp_path / "out")
    assert open_sweep(tmp_path / "out").identical(whole)


@pytest.mark.thorough
def test_a_running_scheduler_is_used_by_its_address(study, tmp_path: Path) -> None:
    """A real `dask scheduler` and two workers, each a process of its own."""
    text = '[grid]\n"scene.rig.x_m" = [0.0, 0.3]\n"system.readout.read_noise_e" = [1.0, 2.0]\n'
    path = study(text)
    with running_scheduler(tmp_path / "scheduler.json", n_workers=2) as (address, _):
        run_sweep(path, out=tmp_path / "far", scheduler=address)
    assert_is_what_one_process_gives(open_sweep(tmp_path / "far"), path)


@contextmanager
def running_scheduler(
    file: Path, n_workers: int
) -> Iterator[tuple[str, "subprocess.Popen[bytes]"]]:
    """Address and process of a `dask scheduler`, with workers."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    worker = [sys.executable, "-m", "distributed.cli.dask_worker"]
    common = ["--scheduler-file", str(file), "--no-dashboard"]
    processes = [subprocess.Popen([*dask, *common, "--port", "0"], **quiet)]
    try:
        for _ in range(n_workers):
            processes.append(
                subprocess.Popen([*worker, *common, "--nthreads", "1", "--no-nanny"], **quiet)
            )
        for _ in range(200):
            if file.is_file() and file.stat().st_size:
                break
            time.sleep(0.1)
        yield json.loads(file.read_text())["address"], processes[0]
    finally:
        for process in reversed(processes):
            process.kill()
        for process in processes:
            process.wait(timeout=20)


@pytest.mark.thorough
def test_a_scheduler_that_goes_away_ends_in_one_line(
    study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Killed once the first of 40 points is stored: how many are, and that the command resumes,
    which it does; without a word of Dask's own.
    """
    distances = [1 + k / 10 for k in range(40)]
    path = study(f'[grid]\n"link.distance_m" = {distances}\n', CLOSED)
    out = tmp_path / "out"
    monkeypatch.setattr("twin.sweep.run._CLOSED_CHUNK", 1)
    add = Store.add
    with running_scheduler(tmp_path / "scheduler.json", n_workers=1) as (address, process):

        def add_and_kill(self: Store, *args: Any, **given: Any) -> None:
            add(self, *args, **given)
            process.kill()

        monkeypatch.setattr(Store, "add", add_and_kill)
        told = rf"^scheduler {address} has gone; [1-9] of 40 points are stored, the same command"
        with pytest.raises(SchedulerGoneError, match=told):
            run_sweep(path, out=out, scheduler=address)
    assert "Traceback" not in capfd.readouterr().err
    monkeypatch.setattr(Store, "add", add)
    assert run_sweep(path, out=out, workers=0).n_failed == 0
    assert_is_what_one_process_gives(open_sweep(out), path)


def test_a_process_that_dies_while_it_starts_is_said(study, tmp_path: Path) -> None:
    path = study('[grid]\n"link.distance_m" = [1.0, 2.0]\n', CLOSED)
    here = psutil.Process()
    others = set(here.children())

    def kill() -> None:
        deadline_s = time.monotonic() + 20
        while time.monotonic() < deadline_s:
            for child in set(here.children()) - others:
                if any("spawn_main" in word for word in child.cmdline()):
                    child.kill()
                    return
            time.sleep(0.01)

    killer = Thread(target=kill)
    killer.start()
    told = "process died while it started .*; 0 of 2 points are stored, the same command resumes"
    with pytest.raises(SchedulerGoneError, match=told):
        run_sweep(path, out=tmp_path / "out", workers=1)
    killer.join()
    assert run_sweep(path, out=tmp_path / "out", workers=0).n_failed == 0


@pytest.mark.thorough
def test_a_process_in_a_dead_ones_place_shares_the_cores_too() -> None:
    """It is told by its first work; told once, together with the others, it would not know."""
    with dask(None, 1) as submit:
        first = submit.result(submit(os.getpid))
        os.kill(first, signal.SIGKILL)
        threads = submit.result(submit(os.getenv, "OMP_NUM_THREADS"))
        assert submit.result(submit(os.getpid)) != first
    assert threads == str(len(os.sched_getaffinity(0)))


def test_a_scheduler_without_workers_is_said(
    study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """At once, with what to do, and an end to it; a worker that comes in time is taken."""
    from threading import Timer

    from distributed import LocalCluster

    path = study('[grid]\n"link.distance_m" = [1.0, 2.0]\n', CLOSED)
    monkeypatch.setattr("twin.workers.pool.WITHOUT_WORKERS_S", 1.0)
    quiet = {"dashboard_address": "127.0.0.1:0", "silence_logs": 50, "threads_per_worker": 1}
    with LocalCluster(n_workers=0, processes=False, **quiet) as cluster:
        with pytest.raises(SchedulerGoneError, match="no workers for 1 s; start one: dask worker"):
            run_sweep(path, out=tmp_path / "none", scheduler=cluster.scheduler_address)
        assert "no workers; waiting" in capsys.readouterr().err
        monkeypatch.setattr("twin.workers.pool.WITHOUT_WORKERS_S", 60.0)
        monkeypatch.setattr("twin.workers.pool.LOOK_S", 0.1)
        late = Timer(0.5, cluster.scale, [1])
        late.start()
        done = run_sweep(path, out=tmp_path / "none", scheduler=cluster.scheduler_address)
        late.join()
    assert done.n_failed == 0
    assert "no workers; waiting" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('[grid]\n"system.optics.f_numbr" = [1.0]\n', "did you mean system.optics.f_number?"),
        ('[grid]\n"fidelity.radar_rays" = [9]\n', "any more; it gave way to radar_tolerance"),
        ('[grid]\n"system.optics.f_number" = []\n', "f_number"),
        ('[grid]\n"scene.objects.*.colour" = [1.0]\n', "'colour' is none of reflectance"),
        ('[grid]\n"system.optics.f_number" = [1.0, 1.0]\n', "stands twice"),
        ('[grid]\n"system.filter.width_m" = ["12 s"]\n', "expected a number or a quantity in m"),
        ('[grid]\n"system.emitter.rows" = [16]\n', "given twice"),
        (
            '[grid]\n"weather.visibility_m" = [50]\n"system.weather.visibility_m" = [500]\n',
            "system.weather.visibility_m: is given twice, as weather.visibility_m too",
        ),
        (
            '"system.weather.visibility_m" = 500\n[grid]\n"weather.visibility_m" = [50, 500]\n',
            "weather.visibility_m: is given twice, as system.weather.visibility_m too",
        ),
        (
            '[grid]\n"link.nope" = [1]\n',
            "link.nope: is no parameter; there are link.distance_m, link.reflectance",
        ),
        (
            '[grid]\n"zzz" = [1]\n',
            "zzz: is no parameter; there are scene…, system…, radar…, seed…",
        ),
        (
            '[[zip]]\n"system.optics.f_number" = [1.0]\n"link.distance_m" = [1.0, 2.0]\n',
            "different lengths",
        ),
        ('[sample]\nmethod = "random"\nn = 4\n[sample.ranges]\n"seed" = {low=1,high=2}', "method"),
        (
            '[sample]\nmethod = "sobol"\nn = 4\n[sample.ranges]\n'
            '"system.optics.f_number" = { low = 4.0, high = 1.0 }\n',
            "low below high",
        ),
        (
            '[sample]\nmethod = "sobol"\nn = 4\n[sample.ranges]\n'
            '"link.distance_m" = { low = [], high = 1.0 }\n',
            "sample.ranges.link.distance_m.low = []: expected a number; ",
        ),
        ("colour = 1\n", "colour"),
        *(
            (f'[grid]\n"{name}" = [1.0, {value}]\n', f"{name} = {told}: expected {wanted}")
            for name, value, told, wanted in (
                ("link.distance_m", "0.0", "0.0", "a positive number"),
                ("link.distance_m", '"-20 cm"', "-0.2", "a positive number"),
                ("link.reflectance", "1.5", "1.5", "0 to 1"),
            )
        ),
        (
            '[sample]\nmethod = "sobol"\nn = 4\n[sample.ranges]\n'
            '"link.distance_m" = { low = -1.0, high = 4.0 }\n',
            "link.distance_m = -1.0: expected a positive number",
        ),
    ],
)
def test_bad_studies_are_named(study, text: str, complaint: str) -> None:
    with pytest.raises(InputError, match=r"study\.toml") as caught:
        load_study(study(text))
    assert complaint in str(caught.value)


def test_unknown_metrics_suggest_the_nearest(study, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="did you mean snr_median"):
        load_study(study("", SMALL.replace("snr_median", "snr_medain")))
    plan = load_study(study("", SMALL.replace('"psnr_db"', '"nowhere:f"')))
    with pytest.raises(ValueError, match="No module"):
        run_sweep(plan, out=tmp_path / "out")


def test_other_results_and_too_many_points_are_refused(study, tmp_path: Path) -> None:
    one = study('[grid]\n"link.distance_m" = [1.0]\n', CLOSED, name="one")
    two = study('[grid]\n"link.distance_m" = [2.0]\n', CLOSED, name="two")
    run_sweep(one, out=tmp_path / "out")
    with pytest.raises(
        InputError,
        match=r"of another study: name = one, not two; .*distance_m = 1, not 2; expected",
    ):
        run_sweep(two, out=tmp_path / "out")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter").write_text("x")
    with pytest.raises(InputError, match="holds no sweep"):
        run_sweep(one, out=tmp_path / "full")
    with pytest.raises(InputError, match="holds no sweep"):
        open_sweep(tmp_path / "full")
    many = study(
        '[sample]\nmethod = "sobol"\nn = 10000000\n[sample.ranges]\n'
        '"system.optics.f_number" = { low = 1.0, high = 4.0 }\n'
        '[grid]\n"link.reflectance" = [0.1, 0.2]\n',
        CLOSED,
        name="many",
    )
    with pytest.raises(InputError, match="20000000 points; --yes"):
        run_sweep(many, out=tmp_path / "many")
    assert not (tmp_path / "many").exists()


def test_a_full_disk_is_found_before_the_work(study, tmp_path: Path, monkeypatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(InputError, match="No space left"):
        run_sweep(study('[grid]\n"scene.rig.x_m" = [0.0]\n'), out=tmp_path / "out", workers=1)


def test_front_by_hand(study, tmp_path: Path) -> None:
    """Four points of which one is beaten."""
    gains = np.array([[1.0, 2.0, 3.0, 1.0, np.nan], [3.0, 2.0, 1.0, 1.0, 9.0]])
    assert sorted(pareto_front(gains)) == [0, 1, 2]
    run_sweep(
        study('[grid]\n"link.distance_m" = [1.0, 2.0]\n"link.reflectance" = [0.2, 0.4]\n', CLOSED),
        out=tmp_path / "out",
    )
    data = open_sweep(tmp_path / "out")
    assert plot_plane(data, "snr", "link.distance_m", "link.reflectance").axes
    assert plot_plane(data, "snr", "link.distance_m").axes
    assert plot_front(data, "snr", "minimum_time_s").axes
    with pytest.raises(InputError, match="is none of"):
        plot_plane(data, "snr", "distance")


@pytest.mark.whole
def test_radar_metrics_come_along(study, a_worker: str, tmp_path: Path) -> None:
    head = 'scene = "yard"\nmetrics = ["detections", "range_error_m"]\n'
    text = '[set]\n"radar.waveform.n_slots" = 64\n"fidelity.radar_tolerance" = 0.3\n'
    path = study(text + '[grid]\n"radar.front_end.noise_figure_db" = [13.0, 70.0]\n', head)
    run_sweep(path, out=tmp_path / "out", scheduler=a_worker)
    data = open_sweep(tmp_path / "out")
    assert data["detections"][0] == 5
    assert data["detections"][1] < 5
    assert data["range_error_m"][0] < 0.1  # a body answers with its front
