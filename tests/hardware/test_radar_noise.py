"""Noise that is not white: channels that share it, clutter.

Statistical tests count cells above thresholds; a window makes about seven neighbours exceed
together, and bounds are four standard deviations of counts that clump so, or wider.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import special

from hardware.radar import Cfar, MapNoise, OfdmWaveform, cfar_threshold, range_doppler
from hardware.radar.k_distribution import fit, survival
from hardware.radar.process import process
from hardware.radar.settings import Processing
from hardware.radar.whitening import whiten
from hardware.radar.windows import noise_gain
from tests.hardware.radar_cubes import TURNS, WIDE, Echo, cube, noise


def shared_noise(rng: np.random.Generator, share: float, n: int, m: int) -> np.ndarray:
    """12 channels (12, n, m), of which fours share noise of power ``share`` beside their own."""
    common = np.sqrt(share) * noise(rng, 3, 1, n, m)
    return (common + noise(rng, 3, 4, n, m)).reshape(12, n, m)


@pytest.mark.parametrize("share", [1.0, 43.0])
@pytest.mark.parametrize(("method", "window"), [("ca", "blackmanharris"), ("os", "boxcar")])
def test_channels_that_share_noise_alarm_at_the_rate_asked_for(share, method, window) -> None:
    """Measured leakage has 43 times the thermal noise in common: 12 channels tell as much as 3.1.

    2^17 cells at 1e-3 are 131 alarms, within 45 (windowed: 80) of it; thresholds for 12
    independent channels are exceeded 3 and 40 times as often.
    """
    rng = np.random.default_rng(5)
    channel = shared_noise(rng, share, 1024, 128).astype(np.complex64)
    image = range_doppler(channel, replace(TURNS, n_slots=128), window)
    cfar = Cfar(1e-3, method)
    threshold = cfar_threshold(image.power_w, cfar, MapNoise(window, image.n_channels))
    alarms = np.sum(image.power_w > threshold)
    assert alarms == pytest.approx(131, abs=45 if window == "boxcar" else 80)
    eigenvalues = np.array([1 + 4 * share] * 3 + [1] * 9)
    looks = eigenvalues.sum() ** 2 / np.sum(eigenvalues**2)
    assert image.effective_looks == pytest.approx(looks, rel=0.1)


def test_independent_channels_stay_as_they_are() -> None:
    """Bit for bit, and echoes with them: what is not there is not taken out."""
    rng = np.random.default_rng(6)
    images = list(noise(rng, 12, 64, 1024))
    images[3][5, 70:90] += 1000.0
    same, looks = whiten(images)
    assert looks == 12
    assert all(np.array_equal(a, b) for a, b in zip(same, images, strict=True))


def test_the_last_ranges_are_whitened_as_the_others_are() -> None:
    """128 ranges in blocks of 60: the last 8 have the power of the first 60 within 20 % (five
    deviations of 3072 values, whose covariance is known within a sixth), and two channels of one
    transmitter a correlation below 0.35 (false alarms below 1e-6). Told in part by ranges that were
    whitened already, the power was 5 to 9 times that, and noise was detected.
    """
    images = list(shared_noise(np.random.default_rng(8), 10.0, 32, 128))
    white = np.stack(whiten(images)[0])
    last = white[:, :, 120:]
    power = np.mean(np.abs(last) ** 2)
    assert power == pytest.approx(np.mean(np.abs(white[:, :, :60]) ** 2), rel=0.2)
    assert abs(np.mean(last[0] * last[1].conj())) < 0.35 * power


def dead(channel: np.ndarray) -> None:
    channel[2] = 0


def copied(channel: np.ndarray) -> None:
    channel[2] = channel[6]


def hardly_alive(channel: np.ndarray) -> None:
    channel[2] *= 1e-6


@pytest.mark.parametrize("fault", [dead, copied, hardly_alive])
@pytest.mark.parametrize("window", ["blackmanharris", "boxcar"])
def test_combinations_of_channels_without_noise_are_left_out(fault, window) -> None:
    """Of 8 channels 7 tell noise: its level within 3 %, as many alarms as asked for (131, within 45
    and 80 as above). Of what rounding leaves of the eighth alone the level was 1e-16 of that.
    """
    channel = noise(np.random.default_rng(9), 8, 1024, 128)
    fault(channel)
    image = range_doppler(channel, replace(TURNS, n_slots=128), window)
    assert image.n_channels == 7
    total = np.mean(np.sum(np.abs(channel) ** 2, axis=0))
    due_w = total / 7 / channel[0].size * noise_gain(window, channel.shape[1:])
    assert image.noise_w == pytest.approx(due_w, rel=0.03 if fault is not copied else 0.2)
    threshold = cfar_threshold(image.power_w, Cfar(1e-3), MapNoise(window, image.n_channels))
    alarms = np.sum(image.power_w > threshold)
    assert alarms == pytest.approx(131, abs=45 if window == "boxcar" else 80)


def test_an_echo_of_any_direction_keeps_its_power_in_the_mean() -> None:
    """Whitening takes from directions along the shared noise and gives to the others."""
    rng = np.random.default_rng(7)
    images = list(shared_noise(rng, 10.0, 64, 1024))
    ways = noise(rng, 12, 200)
    for image, way in zip(images, ways, strict=True):
        image[1, :200] += 1e4 * way
    white, _ = whiten(images)
    gain = np.mean([np.abs(image[1, :200]) ** 2 for image in white]) / 1e8
    assert gain == pytest.approx(np.mean(np.abs(ways) ** 2), rel=0.1)


@pytest.mark.parametrize("shape", [0.5, 1.0, 4.0])
def test_the_k_distribution_is_the_bessel_functions(shape: float) -> None:
    """One look: 2 (v x)^(v/2) K_v(2 sqrt(v x)) / Gamma(v) (Ward, Tough, Watts, 4.3), to 1 %."""
    x = np.array([0.1, 1.0, 4.6, 9.2, 20.0, 60.0])
    bessel = special.kv(shape, 2 * np.sqrt(shape * x))
    exact = 2 / special.gamma(shape) * (shape * x) ** (shape / 2) * bessel
    assert survival(x, 1.0, shape) == pytest.approx(exact, rel=0.01)


def clutter(rng: np.random.Generator, shape: float) -> np.ndarray:
    """A map of 2^19 cells of K-distributed clutter, its mean falling with range."""
    speckle = rng.exponential(size=(2048, 256))
    texture = rng.gamma(shape, 1 / shape, size=(2048, 256)) if np.isfinite(shape) else 1.0
    return speckle * texture * np.exp(-np.arange(2048)[:, None] / 400)


@pytest.mark.parametrize("method", ["ca", "go", "os"])
@pytest.mark.parametrize("shape", [4.0, 1.0])
def test_false_alarms_in_k_distributed_clutter(shape: float, method) -> None:
    """With the shape fitted within a factor of 1.5 at 1e-4 (52 due, four deviations are 29);
    thresholds for noise are exceeded 17 times (shape 4) and 76 times (1) as often.
    """
    power = clutter(np.random.default_rng(8), shape)
    due = 1e-4 * power.size
    plain = np.sum(power > cfar_threshold(power, Cfar(1e-4, method)))
    adapted = np.sum(power > cfar_threshold(power, Cfar(1e-4, method, shape="fitted")))
    assert plain > 12 * due
    assert due / 1.5 < adapted < 1.5 * due


@pytest.mark.parametrize("shape", [0.5, 1.0, 4.0, np.inf])
def test_a_map_says_how_far_it_is_from_noise(shape: float) -> None:
    """The shape within a tenth; noise is noise."""
    found = fit(clutter(np.random.default_rng(9), shape), 1.0)
    assert found.is_noise == np.isinf(shape)
    assert found.shape == pytest.approx(shape, rel=0.12)
    if found.is_noise:
        assert found.exceedance == pytest.approx(1, abs=0.15)


def test_strong_echoes_are_no_clutter() -> None:
    """A dozen of them over 60 dB, with all that a window spreads, leave a map noise."""
    rng = np.random.default_rng(10)
    echoes = [Echo((float(r), 0, 0), 1e-9) for r in rng.uniform(1, 9, 12)]
    frame = process(cube(WIDE, echoes, noise_w=1e-10))
    assert frame.clutter.is_noise
    assert not any("noise" in line for line in frame.warnings)


def test_a_cap_that_cuts_is_told() -> None:
    """And one that does not is not."""
    record = cube(WIDE, [Echo((r, 0, 0), 1e-9) for r in (2.0, 4.0, 6.0)], noise_w=1e-9)
    cut = process(record, 0, Processing(at_most=2))
    assert len(cut.detections) == 2
    assert "more than 2 detections" in cut.warnings[0]
    assert not process(record, 0, Processing(at_most=3)).warnings


def of_cells(cells: np.ndarray):
    """A record whose map without a window is these cells, (n_slots, n_subcarriers)."""
    channel = np.fft.fft(np.fft.fft(cells, axis=1), axis=0)
    received = np.fft.ifft(np.fft.ifftshift(channel * WIDE.sent(), axes=1), axis=1)
    parts = np.stack([received.real, received.imag], axis=-1)
    counts = np.rint(20000 * parts / np.abs(parts).max()).astype(np.int16)
    return replace(cube(WIDE, []), iq=counts[None, None, :, None])


def test_the_shape_is_fitted_where_no_window_evens_clutter_out() -> None:
    """Shape 3, each cell its own, 16 maps at 1e-4: 26 due, fewer than 42 (three deviations).

    A window's map shows shape 25 or noise: fitted to it alone, thresholds gave 59.
    """
    rng = np.random.default_rng(12)
    how = Processing(cfar=Cfar(1e-4, shape="fitted"))
    alarms = 0
    for _ in range(16):
        cells = noise(rng, 64, 256) * np.sqrt(rng.gamma(3, 1 / 3, size=(64, 256)))
        alarms += len(process(of_cells(cells), 0, how).detections)
    assert alarms < 42


def test_side_lobes_of_strong_echoes_are_no_clutter() -> None:
    """With a shape fitted, noise with an echo of 60 dB is noise still: one of 22 dB is found."""
    echoes = [Echo((4.0, 0, 0), 1e-9), Echo((7.0, 0, 0), 1e-9 * 10**-3.8, (2.0, 0, 0))]
    record = cube(WIDE, echoes, noise_w=1e-15 * WIDE.n_subcarriers * WIDE.n_slots)
    assert len(process(record, 0, Processing(cfar=Cfar(1e-6, shape="fitted"))).detections) == 2


def test_clutter_is_told_with_the_frame() -> None:
    """Cells of the map without a window drawn as K-distributed clutter of shape 0.5."""
    rng = np.random.default_rng(11)
    cells = noise(rng, 64, 256) * np.sqrt(rng.gamma(0.5, 2, size=(64, 256)))
    record = of_cells(cells)
    plain = process(record, 0, Processing(window="boxcar"))
    assert any("K-distributed clutter of shape" in line for line in plain.warnings)
    assert "more than 64 detections" in plain.warnings[0]
    adapted = Processing(window="boxcar", cfar=Cfar(shape="fitted"))
    assert not process(record, 0, adapted).warnings


@pytest.mark.parametrize(
    ("n_ranges", "n_slots", "snr_db"), [(2, 2, 60.0), (1, 64, 3.0), (1, 64, 6.0)]
)
def test_one_echo_in_a_map_of_few_cells_is_no_clutter(n_ranges, n_slots, snr_db: float) -> None:
    """Noise exceeds the level in 0.01 cells of 4, in 0.2 of 64: an echo below 100 times the median
    does in 1 and in 5. The signal-to-noise ratio is that of a sample.
    """
    wave = replace(WIDE, n_subcarriers=n_ranges, n_slots=n_slots)
    rng = np.random.default_rng(13)
    echo = np.exp(0.2j * np.pi * (np.arange(n_ranges)[:, None] + np.arange(n_slots)))
    for _ in range(30):
        cells = 10 ** (snr_db / 20) * echo + noise(rng, n_ranges, n_slots)
        image = range_doppler(cells, wave)
        clump = noise_gain("blackmanharris", (n_ranges, n_slots)) ** 1.4
        found = fit(image.power_w, 1, clump)
        assert found.is_noise
        assert np.isinf(found.shape)


@pytest.mark.parametrize("shape", [0.0, -1.0, float("nan"), "fit"])
def test_impossible_shapes(shape) -> None:
    with pytest.raises((ValueError, TypeError), match="shape"):
        Cfar(shape=shape)


@pytest.mark.parametrize("seed", range(4))
def test_several_echoes_on_eight_channels_are_no_clutter(seed: int) -> None:
    """Four of 28 to 33 dB: below 100 times the median, and with eight channels far above noise."""
    rng = np.random.default_rng(seed)
    wave = OfdmWaveform(79e9, 64, 4e6, 32, 20e-6, 1, 0.25e-6)
    f, t = wave.frequency_offsets_hz[:, None], wave.slot_times_s
    channel = rng.normal(size=(8, 64, 32, 2)).view(np.complex128)[..., 0] / np.sqrt(2)
    for place, snr_db in enumerate((28, 30, 31, 33)):
        delay_s, doppler_hz = (6.3 + 15 * place) * wave.delay_cell_s, rng.uniform(-2e4, 2e4)
        echo = np.exp(2j * np.pi * (doppler_hz * t - f * delay_s + rng.uniform(size=(8, 1, 1))))
        channel += 10 ** (snr_db / 20) / np.sqrt(8 * 64 * 32) * echo
    image = range_doppler(channel, wave)
    assert fit(image.power_w, 8, 7.0).is_noise
