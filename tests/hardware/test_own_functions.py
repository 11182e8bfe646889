"""A user's own reconstruction and detection: in Python, from a file, and as `ugv` takes them."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from radar_cubes import WIDE, Echo, cube
from ugv_command import ugv

from hardware import (
    Detection,
    InputError,
    Log,
    OwnFunctionError,
    PatternSet,
    Processing,
    SpiRecord,
    detect,
    process,
    range_image,
    reconstruct,
    write_radar_record,
    write_record,
)
from hardware.own_functions import digest_of, own_function
from hardware.records.state import QuaternionPose, Shutter

PATTERNS = PatternSet(8, 8, 64)
ARGUMENTS = ("values", "noise_variance", "sensing")
INVERSE = """
import numpy as np
import scale

def inverse(values, noise_variance, sensing):
    "Plain inverse of a full set."
    cells = scale.FACTOR * sensing.adjoint(values) / sensing.n_cells
    return cells, np.full(sensing.n_cells, np.sqrt(noise_variance / sensing.n_cells))

def loudest(channel, waveform, image):
    from hardware import detect
    return detect(channel, waveform, image)[:1]
"""


def camera_record() -> SpiRecord:
    cells = np.random.default_rng(0).integers(0, 500, size=64)
    n = PATTERNS.n_exposures
    return SpiRecord(
        counts=PATTERNS.signal(cells).astype(np.int32).reshape(n, 1),
        device_time_ns=np.arange(n, dtype=np.int64),
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, np.uint8),
        patterns=PATTERNS,
        integration_time_s=1e-4,
        electrons_per_count=2.0,
        offset_counts=0.0,
        adc_bits=24,
        device="test",
        pose=QuaternionPose(),
    )


@pytest.fixture
def own_file(tmp_path: Path) -> Path:
    (tmp_path / "scale.py").write_text("FACTOR = 1\n")
    (tmp_path / "mine.py").write_text(INVERSE)
    return tmp_path / "mine.py"


def inverse(values, noise_variance, sensing):
    return sensing.adjoint(values) / sensing.n_cells


def test_own_reconstruction_gives_what_the_bundled_one_of_the_same_formula_gives(own_file) -> None:
    """Object and file alike; a full noise-free set has one image, the plain inverse."""
    record = camera_record()
    bundled = reconstruct(record, "zero-fill")
    for given in (inverse, f"{own_file}:inverse"):
        found = reconstruct(record, given)
        np.testing.assert_allclose(found.image, bundled.image, rtol=1e-12, atol=1e-9)
        assert found.method.startswith("inverse-")
    assert found.standard_error is not None
    assert reconstruct(record, inverse).standard_error is None


def test_own_reconstruction_makes_distances(own_file: Path) -> None:
    """Every image of a record with phase shutters is made by it."""
    plain = camera_record()
    shutters = tuple(Shutter(1e7, phase, 0.0, 0.0) for phase in (0.0, 2.0, 4.0))
    n, light = PATTERNS.n_exposures, plain.counts
    record = replace(
        plain,
        counts=np.vstack([light * k for k in (3, 2, 1)]),
        device_time_ns=np.arange(3 * n),
        sequence=np.arange(3 * n, dtype=np.uint32),
        flags=np.zeros(3 * n, np.uint8),
        shutters=shutters,
    )
    found, bundled = range_image(record, inverse), range_image(record, "zero-fill")
    np.testing.assert_allclose(found.distance_m, bundled.distance_m)
    assert found.method.startswith("inverse-")


def test_a_changed_source_is_another_function(own_file: Path) -> None:
    """The file, a module beside it that it imports, a default, an enclosed value."""
    record, text = camera_record(), f"{own_file}:inverse"
    first = reconstruct(record, text)
    (own_file.parent / "scale.py").write_text("FACTOR = 2\n")  # of the same size and second
    second = reconstruct(record, text)
    np.testing.assert_allclose(second.image, 2 * first.image)
    own_file.write_text(INVERSE + "\n# a remark\n")
    third = reconstruct(record, text)
    assert len({first.method, second.method, third.method}) == 3
    made = [_scaled(1.0), _scaled(2.0), partial(_scaled(1.0), sensing=0), partial(_scaled(1.0), 1)]
    assert len({digest_of(one) for one in made}) == 4
    assert digest_of(_scaled(1.0)) == digest_of(_scaled(1.0))


def test_what_a_function_names_of_its_module_counts(tmp_path: Path) -> None:
    """Constants and arrays, functions that call others, a module beside it; not what the function
    does not name, and not the objects that it fills as it runs.
    """
    text = (
        "import beside, json\nimport numpy as np\nG, OTHER, W = 1.0, 1, np.ones(2)\nSEEN = []\n"
        "def inner(x): return 1 * x\ndef outer(x): return inner(x)\n"
        "def f(values, noise_variance, sensing):\n"
        "    SEEN.append(json)\n    return [outer(v) * G * W + beside.A for v in values]\n"
    )
    variants = (
        text,
        text.replace("W = 1.0", "W = 2.0"),
        text.replace("np.ones", "np.zeros"),
        text.replace("return 1 * x", "return 2 * x"),
        text.replace("W = 1.0, 1,", "W = 1.0, 2,"),
    )
    digests = []
    for number, (content, value) in enumerate([*((v, 1) for v in variants), (text, 2), (text, 1)]):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "beside.py").write_text(f"A = {value}\n")
        (folder / "own.py").write_text(content)
        function = own_function(f"{folder / 'own.py'}:f", ARGUMENTS).function
        digests.append(digest_of(function))
        function([1], 0, 0)
        assert digest_of(function) == digests[-1]
    assert len(set(digests[:4] + digests[5:6])) == 5
    assert digests[0] == digests[4] == digests[6]


def test_a_function_without_a_source_file_counts_by_its_code() -> None:
    made = []
    for text in ("2 * values", "3 * values", "2 * values"):
        names: dict = {}
        exec(f"def f(values, noise_variance, sensing): return {text}", names)
        made.append(digest_of(names["f"]))
    assert made[0] == made[2] != made[1]


def _scaled(factor: float):
    def solve(values, noise_variance, sensing):
        return factor * values

    return solve


def test_two_files_of_one_name_do_not_mix(tmp_path: Path) -> None:
    for name, value in (("a", 1), ("b", 2)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine.py").write_text(
            f"import same\ndef f(values, noise_variance, sensing): return same.X, {value}\n"
        )
        (tmp_path / name / "same.py").write_text(f"X = {value}\n")
    for name, value in (("a", 1), ("b", 2), ("a", 1)):
        own = own_function(f"{tmp_path / name / 'mine.py'}:f", ARGUMENTS)
        assert own.function(0, 0, 0) == (value, value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("nowhere.py:inverse", "nowhere.py does not exist"),
        ("mine.py:absent", "has no function 'absent', only inverse, loudest"),
        ("mine.py:np", "has no function 'np'"),
        ("broken.py:f", "broken.py: SyntaxError"),
        ("raises.py:f", "raises.py: ZeroDivisionError"),
        ("leaves.py:f", "leaves.py: SystemExit: 0"),
        ("two.py:f", r"takes \(a, b\), expected a function of \(values, noise_variance, sensing\)"),
    ],
)
def test_what_is_wrong_with_a_file_is_said(own_file: Path, text: str, told: str) -> None:
    folder = own_file.parent
    (folder / "broken.py").write_text("def f(:\n")
    (folder / "raises.py").write_text("1 / 0\n")
    (folder / "leaves.py").write_text("import sys\nsys.exit(0)\n")
    (folder / "two.py").write_text("def f(a, b): return a\n")
    with pytest.raises(OwnFunctionError, match=told):
        reconstruct(camera_record(), str(folder / text))


@pytest.mark.parametrize(
    ("result", "told"),
    [
        (np.zeros(63), r"cells of shape \(63,\), expected \(64,\)"),
        (np.zeros((8, 8)), r"cells of shape \(8, 8\)"),
        (np.full(64, np.nan), "NaN or infinity in 64 measured cells"),
        (np.zeros(64, complex), "complex128.*, expected real numbers"),
        (None, "type NoneType"),
        ((np.zeros(64), np.zeros(3)), r"standard errors of shape \(3,\)"),
        ((np.zeros(64), np.full(64, -1.0)), "negative standard errors"),
    ],
)
def test_a_result_that_is_no_image_is_refused(result: object, told: str) -> None:
    def mine(values, noise_variance, sensing):
        return result

    with pytest.raises(OwnFunctionError, match=f"mine: returned .*{told}"):
        reconstruct(camera_record(), mine)


def test_own_detection_takes_the_place_of_cfar() -> None:
    """`detect` itself fulfils it: two echoes, or of a user's shorter list the strongest."""
    echoes = [Echo((4.0, 0, 0)), Echo((8.0, 0, 0), 1e-10)]
    record = cube(WIDE, echoes, noise_w=1e-11)
    bundled = process(record)
    own = process(record, how=Processing(detection=partial(detect, window="blackmanharris")))
    assert own.detection.startswith("detect-")
    assert bundled.detection == ""
    for found, known in zip(own.detections, bundled.detections, strict=True):
        assert found.range_m == pytest.approx(known.range_m, abs=1e-3)
        assert found.rcs_m2 == pytest.approx(known.rcs_m2, rel=0.01)  # from power and design
    cut = process(record, how=Processing(detection=detect, at_most=1))
    assert len(cut.detections) == 1
    assert "more than 1 detections" in cut.warnings[-1]


@pytest.mark.parametrize(
    ("result", "told"),
    [
        (None, "returned a NoneType"),
        ([1.0], "item 0 is a float"),
        ([Detection(1.0, 0.0, np.nan, 10.0, 0.1, 0.1)], "power_w or snr_db is not finite"),
        ([Detection(np.nan, np.nan, 1.0, 10.0, 0.1, 0.1)], "neither range nor range rate"),
        ([Detection(-5.0, 0.0, 1.0, 10.0, 0.1, 0.1)], "range_m = -5.0: expected a finite number"),
        ([Detection(np.inf, 0.0, 1.0, 10.0, 0.1, 0.1)], "range_m = inf: expected a finite"),
        ([Detection("5", 0.0, 1.0, 10.0, 0.1, 0.1)], "range_m = '5': expected a number"),
        ([Detection(5.0, np.inf, 1.0, 10.0, 0.1, 0.1)], "range_rate_m_per_s = inf: expected"),
        ([Detection(5.0, 0.0, -1.0, 10.0, 0.1, 0.1)], "power_w = -1.0: expected .* from 0 up"),
        ([Detection(5.0, 0.0, 1.0, 10.0, -0.1, 0.1)], "range_error_m = -0.1: expected .* from 0"),
        ([Detection(5.0, 0.0, 1.0, 10.0, 0.1, 0.1, np.inf)], "azimuth_rad = inf: expected"),
        ([Detection(5.0, 0.0, 1.0, 10.0, 0.1, 0.1, rcs_m2=-1.0)], "rcs_m2 = -1.0: expected"),
    ],
)
def test_a_result_that_is_no_detection_is_refused(result: object, told: str) -> None:
    with pytest.raises(OwnFunctionError, match=told):
        process(
            cube(WIDE, [Echo((4.0, 0, 0))]),
            how=Processing(detection=lambda channel, waveform, image: result),
        )


@pytest.mark.parametrize("given", ["mine", "mine.py:f", lambda record: []])
def test_processing_refuses_a_detection_that_is_none(given) -> None:
    with pytest.raises(
        OwnFunctionError, match=r"^detection: .*(ugv.detection|does not exist|takes \(record\))"
    ):
        Processing(detection=given)


def test_ugv_takes_files(own_file: Path, tmp_path: Path) -> None:
    camera, radar, log = (tmp_path / name for name in ("frame.h5", "radar.h5", "run.mcap"))
    echoes = cube(WIDE, [Echo((4.0, 0, 0)), Echo((8.0, 0, 0), 1e-10)], noise_w=1e-11)
    write_record(camera_record(), camera)
    write_radar_record(echoes, radar)
    done = ugv("reconstruct", camera, "--method", f"{own_file}:inverse")
    assert done.returncode == 0, done.stderr
    (written,) = tmp_path.glob("frame-inverse-*.npz")
    np.testing.assert_array_equal(
        np.load(written)["image"], reconstruct(camera_record(), f"{own_file}:inverse").image
    )
    done = ugv("detect", radar, "--detection", f"{own_file}:loudest")
    assert "1 detections by loudest-" in done.stdout, done.stderr
    with Log(log) as out:
        out.record("/spi/record", camera_record())
        out.record("/radar/record", echoes)
    given = ("--method", f"{own_file}:inverse", "--detection", f"{own_file}:loudest")
    done = ugv("process", log, *given, "-o", tmp_path / "done.mcap")
    assert done.returncode == 0, done.stderr
    assert "1 detections by loudest-" in done.stdout
    done = ugv("process", log, "--method", f"{own_file}:absent", "-o", tmp_path / "not.mcap")
    assert done.returncode == 2
    assert "has no function 'absent'" in done.stderr
    assert not (tmp_path / "not.mcap").exists()


def test_what_an_own_function_raises_is_an_error_with_its_line(tmp_path: Path) -> None:
    """Its own faults, and an end of the program: not a traceback, and never exit status 0."""
    (tmp_path / "own.py").write_text(
        "import sys\ndef leaves(v, n, s): sys.exit(0)\ndef fails(v, n, s): return {}['a']\n"
    )
    write_record(camera_record(), tmp_path / "record.h5")
    for name, told in (("leaves", "SystemExit: 0"), ("fails", "KeyError: 'a'")):
        given = f"{tmp_path / 'own.py'}:{name}"
        with pytest.raises(OwnFunctionError, match=rf"{name}: {told} \(.*own\.py, line \d\)"):
            reconstruct(camera_record(), given)
        ended = ugv("reconstruct", str(tmp_path / "record.h5"), "--method", given)
        assert ended.returncode == 2
        assert ended.stderr.startswith(f"ugv: error: {name}: {told}")


@np.errstate()  # a failure ends here
def test_what_an_own_function_tells_numpy_ends_with_it() -> None:
    """Also where it fails: what comes after it underflows as before."""
    before = np.geterr()

    def careful(values, noise_variance, sensing):
        np.seterr(all="raise")
        return inverse(values, noise_variance, sensing)

    def fails(values, noise_variance, sensing):
        np.seterr(all="raise")
        return np.log(np.zeros(3))

    reconstruct(camera_record(), careful)
    assert np.geterr() == before
    with pytest.raises(OwnFunctionError, match="fails: FloatingPointError"):
        reconstruct(camera_record(), fails)
    assert np.geterr() == before


@pytest.mark.parametrize("given", [5, None, [], np.mean])
def test_what_is_no_method_is_an_error(given) -> None:
    with pytest.raises(InputError, match=r"method: .* expected a name|mean: TypeError"):
        reconstruct(camera_record(), given)
