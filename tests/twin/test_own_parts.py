"""A user's own detector and weather, named in a system's file: through runs and studies."""

from pathlib import Path

import numpy as np
import pytest

from hardware import Flag, read_record
from twin import (
    Air,
    Fidelity,
    FrontEnd,
    InputError,
    System,
    capture,
    load_radar,
    load_scene,
    load_system,
    radar_capture,
    run,
)
from twin.budget.design import wall_rows
from twin.sweep import load_study, open_sweep, run_sweep

QUICK = Fidelity(samples=4, max_depth=1, noise="gaussian", radar="targets")
CODE = '''
from dataclasses import dataclass, replace
import numpy as np
from twin import Air, FrontEnd

SHARE = 1.0

def brighter(system):
    """The bundled photodiode, of so many times the response."""
    known = FrontEnd.of(system)
    return replace(known, electrons_per_watt=SHARE * known.electrons_per_watt)

def blinded(system):
    """One whose counts are all at the rail."""
    class Blinded(FrontEnd):
        def expose(self, power_w, *, rng, noise="full"):
            top = 2**self.adc_bits - 1
            return np.full(power_w.shape, top, np.int32), np.ones(len(power_w), np.uint8)
    return Blinded(**vars(FrontEnd.of(system)))

class Dust:
    """Extinction by grams per cubic metre, told in the section's smoke."""
    def __init__(self, weather):
        self.g_per_m3 = 1e3 * weather.smoke_kg_per_m3.value
    def air(self, wavelength_m):
        extinction = 0.05 * self.g_per_m3
        return Air(extinction, 0.0, 0.0)
    def db_per_m(self, carrier_hz):
        return 0.02 * self.g_per_m3

def nothing(section):
    return section

def ends(section):
    raise SystemExit("was run")

def of_two(one, other):
    return one
'''


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "mine.py").write_text(CODE)
    return tmp_path


def system_of(folder: Path, text: str):
    (folder / "system.toml").write_text(f'base = "workable"\n{text}')
    return load_system(folder / "system.toml")


def test_a_detector_in_a_systems_file_is_taken(folder: Path) -> None:
    """The bundled one made by a user's function gives the bundled one's bits."""
    scene = load_scene("table1")
    system = system_of(folder, '[detector]\nfunction = "mine.py:brighter"\n')
    flat = load_system("workable").with_({"detector.responsivity_csv": None})
    taken = [capture(scene, one, seed=1, fidelity=QUICK) for one in (flat, system)]
    assert taken[0].record.electrons_per_count == taken[1].record.electrons_per_count
    (folder / "mine.py").write_text(CODE.replace("SHARE = 1.0", "SHARE = 2.0"))
    double = capture(scene, system, seed=1, fidelity=QUICK)
    assert double.noise.signal_e == pytest.approx(2 * taken[1].noise.signal_e)


def test_saturation_of_an_own_detector_makes_a_run_void(folder: Path) -> None:
    """Its flags and counts reach record, verdict and report."""
    system_of(folder, '[detector]\nfunction = "mine.py:blinded"\n')
    result = run(
        "table1",
        folder / "system.toml",
        compare=None,
        radar=None,
        fidelity=QUICK,
        out=folder / "out",
    )
    assert (read_record(result.out / "record.h5").flags == Flag.SATURATED).all()
    assert result.evaluations[0].verdict.void
    page = (result.out / "report.html").read_text()
    assert "Blinded in place of the system" in page
    assert "saturat" in page


def test_studies_take_detectors_and_know_their_versions(folder: Path) -> None:
    (folder / "other.py").write_text(CODE.replace("SHARE = 1.0", "SHARE = 2.0"))
    (folder / "study.toml").write_text(
        'scene = "table1"\nmetrics = ["signal_e"]\n[set]\n"fidelity.preset" = "draft"\n[grid]\n'
        '"system.detector.function" = ["mine.py:brighter", "other.py:brighter"]\n'
    )
    done = run_sweep(load_study(folder / "study.toml"), out=folder / "out", workers=0)
    assert done.n_failed == 0, done.reasons
    one, two = open_sweep(done.out).signal_e.values
    assert two == pytest.approx(2 * one)
    (folder / "other.py").write_text(CODE)
    with pytest.raises(InputError, match=r"other content of.* function other\.py:brighter"):
        run_sweep(load_study(folder / "study.toml"), out=folder / "out", workers=0)


def test_weather_of_a_function_acts_on_light_and_waves(folder: Path) -> None:
    """Transmission of both to closed form: light by Beer and Lambert over twice the distance, the
    radar by dB/m over the way there and back.
    """
    text = '[weather]\nfunction = "mine.py:Dust"\nsmoke_kg_per_m3 = 2e-3\n'
    dusty = system_of(folder, text)
    scene = load_scene("table1")
    clear, seen = (
        capture(scene, one, seed=1, fidelity=QUICK) for one in (load_system("workable"), dusty)
    )
    wall = np.isfinite(clear.truth.depth_m) & (clear.cells_e > 0)
    lost = np.log(clear.cells_e[wall] / seen.cells_e[wall])
    assert np.median(lost) == pytest.approx(2 * 0.1 * np.median(clear.truth.depth_m[wall]), rel=0.1)
    radar, yard = load_radar("hybrid-79"), load_scene("yard")
    air = radar_capture(yard, radar, seed=1, fidelity=QUICK, weather=dusty.weather).air
    assert air.db_per_m(79e9) == 0.04
    assert "Dust attenuates by 40 dB/km" in air.describe(79e9)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[detector]\nfunction = 'mine.py:nothing'\n", "detector.function: nothing gave a System,"),
        ("[weather]\nfunction = 'mine.py:nothing'\n", "weather.function: nothing gave a Weather"),
    ],
)
def test_what_is_no_part_is_told(folder: Path, text: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        capture(load_scene("table1"), system_of(folder, text), fidelity=QUICK)


@pytest.mark.parametrize("section", ["detector", "weather", "waveform"])
@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("mine.py:absent", "mine.py has no function 'absent'"),
        ("none.py:f", "none.py does not exist"),
        (
            "spad",
            "'spad': is unknown, expected file.py:function or a name in .* group twin.SECTION",
        ),
        ("", "'': is unknown, expected file.py:function"),
        ("mine.py:of_two", "takes .*, expected a function of"),
    ],
)
def test_a_function_is_looked_up_and_not_run_when_its_file_is_loaded(
    folder: Path, section: str, given: str, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run computes for a minute before it makes the detector: what is misspelt is told before."""
    monkeypatch.chdir(folder)  # what a name in Python is relative to
    load, base = (load_radar, "hybrid-79") if section == "waveform" else (load_system, "workable")
    path = folder / "own.toml"
    path.write_text(f'base = "{base}"\n[{section}]\nfunction = "{given}"\n')
    said = told.replace("SECTION", section)
    with pytest.raises(InputError, match=rf"own\.toml: {section}\.function: .*{said}"):
        load(path)
    with pytest.raises(InputError, match=rf"{section}\.function: .*{said}"):
        load(base).with_({f"{section}.function": given})
    if section != "waveform":  # whose symbols are part of the design, and checked with it
        path.write_text(f'base = "{base}"\n[{section}]\nfunction = "mine.py:ends"\n')
        assert getattr(load(path), section).function.value.endswith("mine.py:ends")


def test_the_radar_names_the_field_of_a_weather(folder: Path) -> None:
    """Not one of its own design, which the user's file does not have."""
    dusty = system_of(folder, '[weather]\nfunction = "mine.py:ends"\n')
    with pytest.raises(InputError, match=r"^weather\.function: ends: SystemExit"):
        radar_capture(load_scene("yard"), load_radar("hybrid-79"), weather=dusty.weather)


def test_closed_formulas_refuse_what_they_do_not_know(folder: Path) -> None:
    system = system_of(folder, '[detector]\nfunction = "mine.py:brighter"\n')
    with pytest.raises(InputError, match="closed formulas know the bundled photodiode"):
        wall_rows(system, [10.0], [0.5])


class Careful:
    """Weather and the bundled photodiode, whose methods ask NumPy to raise each time."""

    def __init__(self, section) -> None:
        self.known = FrontEnd.of(section) if isinstance(section, System) else None

    def __getattr__(self, name: str):
        value = getattr(self.__dict__["known"], name)
        return self._calling(value) if callable(value) else value

    def air(self, wavelength_m):
        return self._calling(Air)(0.1, 0.0, 0.0)

    def db_per_m(self, carrier_hz):
        return self._calling(float)(0.01)

    @staticmethod
    def _calling(function):
        def call(*arguments, **named):
            with np.errstate():
                result = function(*arguments, **named)
            np.seterr(all="raise")
            return result

        return call


@np.errstate()  # a failure ends here
def test_what_own_parts_tell_numpy_ends_with_them() -> None:
    """Light, counts and echoes underflow where nothing is wrong, which must not raise."""
    before, scene = np.geterr(), load_scene("table1")
    changes = {"weather": {"function": Careful}, "detector.function": Careful}
    system = load_system("workable").with_(changes)
    capture(scene, system, seed=1, fidelity=QUICK)
    assert np.geterr() == before
    radar = load_radar("hybrid-79")
    radar_capture(scene, radar, seed=1, fidelity=QUICK, weather=system.weather)
    assert np.geterr() == before
