"""Noise that is not white: channels that share it, phase noise of the leakage, I/Q images, clutter.

Statistical tests count cells above thresholds; a window makes about seven neighbours exceed
together, and bounds are four standard deviations of counts that clump so, or wider.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import special
from scipy.ndimage import uniform_filter1d

from hardware.errors import InputError
from hardware.radar import Cfar, MapNoise, cfar_threshold, range_doppler
from hardware.radar.burst import demodulate
from hardware.radar.clutter import without_leakage
from hardware.radar.demodulation import complex_samples
from hardware.radar.k_distribution import fit, survival
from hardware.radar.phase_noise import phase_noise
from hardware.radar.process import Processing, process
from hardware.radar.quadrature import branch_faults, by_delay, image_spreads
from hardware.radar.whitening import whiten
from hardware.radar.windows import noise_gain
from hardware.waveform import OfdmWaveform
from tests.hardware.radar_cubes import MIMO, STEP, WIDE, C, Echo, calibrated, cube

#: 3 transmitters by turns and 4 receivers, as `hybrid-79-mimo`, an eighth of its cells.
TURNS = OfdmWaveform(79e9, 1024, 3.90625e6, 129, 39.0625e-6, 37, 0.25e-6)
LEAKAGE_S = 2.2 / TURNS.bandwidth_hz
ROW = np.array([[0, (1.5 - i) * TURNS.wavelength_m / 2, 0] for i in range(4)])
FOURS = {
    "transmitter": (0, 1, 2),
    "transmitters_m": np.array([[0, (1 - i) * 2 * TURNS.wavelength_m, 0] for i in range(3)]),
    "receivers_m": ROW,
}


def noise(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Complex, of mean power 1."""
    return rng.normal(size=(*shape, 2)).view(np.complex128)[..., 0] / np.sqrt(2)


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


def noisy_leakage(echoes, thermal_db: float, phase_rad: float, seed: int = 0):
    """A record with leakage of power 1 whose phase noise all receivers of a slot share.

    Sample by sample from the definition: the sum of all paths, the leakage's turned by d(t), the
    difference of one oscillator's white phase and the same two samples earlier.
    """
    rng = np.random.default_rng(seed)
    bare = cube(TURNS, echoes, counts=1.0, **FOURS)
    n = TURNS.n_subcarriers
    turn = np.exp(-2j * np.pi * TURNS.frequency_offsets_hz * LEAKAGE_S)
    leak = np.fft.ifft(np.fft.ifftshift(TURNS.sent() * turn)) * np.sqrt(n)
    phase = phase_rad / np.sqrt(2) * rng.normal(size=(129, 1, n))
    turned = leak * np.exp(1j * (np.roll(phase, 2, axis=-1) - phase))
    exact = echo_samples(bare, echoes) + turned
    exact = exact + 10 ** (thermal_db / 20) * noise(rng, 129, 4, n)
    parts = np.stack([exact.real, exact.imag], axis=-1) / 1e-4
    record = replace(bare, iq=np.rint(parts).astype(np.int16)[None, None])
    return calibrated(record, root_watt_per_count=1e-4, leakage_delay_s=LEAKAGE_S)


def echo_samples(record, echoes) -> np.ndarray:
    """What the antennas receive of echoes, (n_slots, n_receivers, n_samples), in float64."""
    n = TURNS.n_subcarriers
    f = TURNS.frequency_offsets_hz
    total = np.zeros((129, 4, n), dtype=complex)
    for echo in echoes:
        place = np.asarray(echo.place_m) + np.outer(TURNS.slot_times_s, echo.velocity_m_per_s)
        sending = np.linalg.norm(
            place - record.front_end.transmitters_m[record.transmitter], axis=-1
        )
        receiving = np.linalg.norm(place[:, None] - record.front_end.receivers_m, axis=-1)
        delay = ((sending[:, None] + receiving) / C)[..., None]
        spectrum = np.exp(-2j * np.pi * (TURNS.carrier_hz * delay % 1.0 + f * delay))
        spectrum *= np.sqrt(echo.power_w) * TURNS.sent()
        total += np.fft.ifft(np.fft.ifftshift(spectrum, axes=-1), axis=-1) * np.sqrt(n)
    return total


def floor_db(record, *, leakage: bool = True) -> float:
    """Noise of the channels over thermal noise of -60 dB a sample."""
    channel = demodulate(record, leakage=leakage).channel
    changes = channel - channel.mean(axis=-1, keepdims=True)
    return float(10 * np.log10(np.mean(np.abs(changes) ** 2) * 43 / 42 / 1e-6))


def test_the_leakages_phase_noise_is_taken_out() -> None:
    """Phase noise 17 dB over thermal noise; what is left of both is thermal noise, within 0.6 dB:
    of the mean over four receivers half is the phase noise's and goes with it.
    """
    record = noisy_leakage([], -60, 7e-3)
    assert floor_db(record, leakage=False) == pytest.approx(17, abs=0.3)
    assert floor_db(record) == pytest.approx(10 * np.log10(7 / 8), abs=0.3)


def filtered_phase_noise(rng: np.random.Generator, n_transmitters: int, thermal: float):
    """Spectra (n_transmitters, 85, 1024) of leakage of power 1 whose phase noise (0.01 rad) reaches
    beyond the band, as a receiver's filter leaves it: l(t) d(t) at twice the bandwidth, cut to it.
    """
    n, shape = 1024, (n_transmitters, 85, 1024)
    carrier = np.arange(-n // 2, n // 2)
    sent = np.exp(1j * np.pi * carrier**2 / n)  # Zadoff-Chu: constant modulus over time
    spectrum = np.zeros(2 * n, dtype=np.complex128)
    spectrum[carrier] = sent
    lines = np.fft.rfft(rng.normal(0, 0.01, shape))
    lines[..., -1] = 0
    arrived = np.fft.ifft(spectrum) * np.fft.irfft(lines, 2 * n) * 2
    cut = np.fft.ifft(np.fft.ifftshift(np.fft.fft(arrived)[..., carrier], axes=-1))
    leak = np.fft.ifft(np.fft.ifftshift(sent))
    relative = 1j * cut * leak.conj() / np.abs(leak) * np.sqrt(n)
    return np.fft.fft2(relative + np.sqrt(thermal) * noise(rng, *shape), norm="ortho")


def test_phase_noise_cut_by_the_receivers_filter_is_not_taken_for_echoes() -> None:
    """Cut to the band, phase noise k subcarriers off is missing on k of them: what is left of it
    there is alike over N / 2k range cells, so that means of 33 cells scatter far more than 33
    independent ones. Taken for echoes, noise stayed in where it happened to be high.

    Between 16 and 64 cells from the leakage, 3 transmitters: 0.8 of 8160 cells lie above the level
    of 1e-4, two runs 1.6; 45 did. More than 12, in clumps of up to 8, has a chance below 1e-2.
    """
    above = 0
    for seed in range(2):
        spectra = filtered_phase_noise(np.random.default_rng(seed), 3, 1e-6)
        left = np.mean(np.abs(spectra - phase_noise(spectra)[0]) ** 2, axis=0)
        level = np.median(left, axis=0) / special.gammaincinv(3, 0.5)
        high = left > uniform_filter1d(level, 33, mode="wrap") * special.gammainccinv(3, 1e-4)
        above += np.sum(high[:, 16:64]) + np.sum(high[:, -63:-15])
    assert above <= 12


def test_a_high_cell_of_phase_noise_is_no_echo() -> None:
    """Real noise 20 dB over thermal, one transmitter: what is left is thermal noise, which exceeds
    18 times its mean in 87 040 cells with a chance of 1e-3. Cells of 8 times the mean (e^-8 of all)
    were taken for echoes for their power alone, and kept all of it: 800 times thermal noise.
    """
    rng = np.random.default_rng(3)
    relative = 1j * rng.normal(0, 10, (1, 85, 1024)) + noise(rng, 1, 85, 1024)
    spectra = np.fft.fft2(relative, norm="ortho")
    left = np.abs(spectra - phase_noise(spectra)[0]) ** 2
    assert left.max() < 18


def beside_an_echo(seed: int):
    """Spectra (3, 85, 1024) of phase noise of 6 times the thermal noise and of an echo of 60 dB
    between two range cells, at a rate on a cell: it has no side lobes at other rates, which between
    cells it would have.
    """
    rng = np.random.default_rng(seed)
    relative = 1j * rng.normal(0, np.sqrt(6), (3, 85, 1024)) + noise(rng, 3, 85, 1024)
    relative += 1e3 / np.sqrt(85 * 1024) * np.exp(2j * np.pi * 200.4 / 1024 * np.arange(1024))
    return np.fft.fft2(relative, norm="ortho")


def test_chance_is_no_echo_where_side_lobes_may_be() -> None:
    """About an echo's mirror image at most 7/13 of the thermal noise is left (half, and Wiener's
    error of the phase noise): of 5472 cells 0.5 exceed that level of 1e-4, more than 5 with a
    chance of 1e-4. 32 did, where noise happened to look like an echo and phase noise stayed in.
    """
    above, level = 0, 7 / 13 * special.gammainccinv(3, 1e-4) / 3
    for seed in range(3):
        spectra = beside_an_echo(seed)
        left = np.mean(np.abs(spectra - phase_noise(spectra)[0]) ** 2, axis=0)
        above += np.sum(left[5:-4, -212:-188] > level)
    assert above <= 5


def test_the_noise_that_is_left_beside_an_echo_is_known() -> None:
    """Where phase noise is told by the mirror image alone its thermal noise comes with it, and
    about the mirror image it goes away: 0.3 to 3.5 times 7/13 of the thermal noise, told for every
    cell within 5 % of what is left there (some 1000 cells of 3 transmitters each, 2 %).
    """
    left, told = [], []
    for seed in range(3):
        spectra = beside_an_echo(seed)
        found, more = phase_noise(spectra)
        power = np.mean(np.abs(spectra - found) ** 2, axis=0)[5:-4]
        left.append(power[:, np.r_[170:230, -230:-170]] / (7 / 13))
        told.append(more[5:-4, np.r_[170:230, -230:-170]])
    left, told = np.array(left), np.array(told)
    for low, high in ((0, 0.5), (0.5, 0.99), (0.99, 1.01), (1.01, 2), (2, 4)):
        chosen = (told > low) & (told < high)
        assert chosen.sum() > 500
        assert left[chosen].mean() / told[chosen].mean() == pytest.approx(1, abs=0.05)


def test_leakage_whose_amplitude_changes_over_the_band_is_taken_away() -> None:
    """By 1e-5: of that, 100 dB below it, nothing is left. An echo a cell of range from the leakage
    and 60 dB below it stays as it is, which a fit without a limit would take 85 % of.
    """
    place = np.linspace(-1, 1, STEP.n_subcarriers)
    path = np.exp(-2j * np.pi * STEP.frequency_offsets_hz * LEAKAGE_S)[:, None]
    path = path * np.ones(STEP.n_slots)
    uneven = path * (1 + 1e-5 * (place**2 + 1j * place**3))[:, None]
    assert np.abs(without_leakage(uneven, STEP, LEAKAGE_S)).max() < 1e-12
    turn = np.exp(-2j * np.pi * np.arange(STEP.n_subcarriers) / STEP.n_subcarriers)
    echo = 1e-3 * path * turn[:, None]
    left = without_leakage(path + echo, STEP, LEAKAGE_S)
    assert np.mean(np.abs(left) ** 2) == pytest.approx(1e-6, rel=1e-6)


@pytest.mark.parametrize("azimuth", [0.0, 0.35])
@pytest.mark.parametrize("range_m", [0.5, 1.0, 2.0, 12.0])
def test_echoes_beside_the_leakage_keep_place_and_level(range_m: float, azimuth: float) -> None:
    """From 0.5 m on, straight ahead (where echo and leakage are alike on all receivers) and aside:
    range within 1 mm, power within 0.3 dB. A mirror image about the leakage would be 6 dB lower;
    what is left of it is 38 dB lower.
    """
    place = (range_m * np.cos(azimuth), range_m * np.sin(azimuth), 0.0)
    record = noisy_leakage([Echo(place, 1e-6)], -60, 7e-3)
    found = process(record, 0, Processing(cfar=Cfar(1e-8, "ca"))).detections
    assert all(other.power_w < 10**-3.8 * found[0].power_w for other in found[1:])
    assert found[0].range_m == pytest.approx(range_m, abs=1e-3)
    assert 10 * np.log10(found[0].power_w / 1e-6) == pytest.approx(0, abs=0.3)


def test_a_weak_echo_comes_out_of_the_phase_noise() -> None:
    """7 dB below the window's noise with it, where 5 dB above is what it takes. Below the phase
    noise in its own cell a mirror image about the leakage is left, 10 dB lower at least.
    """
    echo = Echo((12.0, 4.0, 0.0), 1e-9, (1.0, 0.0, 0.0))
    found = process(noisy_leakage([echo], -60, 7e-3)).detections
    assert found[0].range_m == pytest.approx(np.hypot(12, 4), abs=0.02)
    assert all(other.power_w < 0.1 * found[0].power_w for other in found[1:])


def ratio(steps: list[np.ndarray], waveform: OfdmWaveform) -> complex:
    """Amplitude of the first receiver's image over its signal."""
    return complex(branch_faults(*by_delay(steps, waveform), image_spreads(waveform))[1][0])


@pytest.mark.parametrize(("gain_db", "phase_deg"), [(0.2, 1.6), (-1.0, 5.0)])
def test_the_image_of_unlike_branches_is_found(gain_db: float, phase_deg: float) -> None:
    """B = (1 - g exp(-j a)) / (1 + g exp(-j a)) (Valkama et al. 2001), within 2 %; none in a record
    without.
    """
    carriers = 2.26e9 + 20e6 * np.arange(25)
    record = cube(
        STEP, [Echo((5, 0, 0), 1e-8)], carriers_hz=carriers, leakage=(1e-6, 4e-9), noise_w=1e-11
    )
    x = complex_samples(record.iq[0])
    g, angle = 10 ** (gain_db / 20), np.radians(phase_deg)
    y = x.real + 1j * g * (np.cos(angle) * x.imag + np.sin(angle) * x.real)
    turn = g * np.exp(-1j * angle)
    assert ratio(list(y), STEP) == pytest.approx((1 - turn) / (1 + turn), rel=0.02)
    assert ratio(list(x), STEP) == 0


def test_steps_without_leakage_are_joined_as_they_are_and_said_to_be() -> None:
    """Nothing but noise, 12 maps of 25600 cells at 1e-8: a detection by chance once in 300 tests.

    Phases fitted to noise made an echo of it in every other map.
    """
    carriers = 2.26e9 + 20e6 * np.arange(25)
    for seed in range(12):
        silent = cube(STEP, [], carriers_hz=carriers, noise_w=1e-10, seed=seed)
        frame = process(calibrated(silent, leakage_delay_s=4e-9))
        assert not frame.detections
        assert any("no leakage is seen at its delay of 4e-09 s" in line for line in frame.warnings)


def test_leakage_that_is_not_there_turns_no_echo() -> None:
    """An echo of 30 dB is the same though the record tells of leakage.

    Each slot turned by the phase of noise at the leakage's delay, nothing was left of it.
    """
    echo = Echo((5.0, 0.0, 0.0), 1e-9)
    record = cube(WIDE, [echo], noise_w=1e-3 * echo.power_w * WIDE.n_subcarriers * WIDE.n_slots)
    plain, told = (
        process(calibrated(record, leakage_delay_s=delay)) for delay in (float("nan"), 2e-9)
    )
    assert len(plain.detections) == len(told.detections) == 1
    assert told.detections[0].power_w == pytest.approx(plain.detections[0].power_w, rel=0.1)
    assert any("no leakage is seen" in line for line in told.warnings)
    assert not plain.warnings


@pytest.mark.parametrize("above_db", [-10, 15])
@pytest.mark.parametrize("symbols", ["zadoff-chu", "flat"])
def test_a_strong_echo_is_no_phase_noise_of_the_leakage(symbols, above_db: float) -> None:
    """A moving echo of 75 dB and steady leakage of 85 or 60: one detection within 0.05 dB.

    The echo's side lobes at the leakage's delay, taken for changes of the leakage's phase from slot
    to slot, had modulated the echo: up to a dozen ghosts of 43 dB at other rates.
    """
    wave = replace(WIDE, symbols=symbols)
    echo = Echo((5.0, 0, 0), 1e-9, (5.3, 0, 0))
    record = cube(
        wave,
        [echo],
        noise_w=echo.power_w * 10**-7.5 * wave.n_subcarriers * wave.n_slots,
        leakage=(echo.power_w * 10 ** (-above_db / 10), 1e-9),
    )
    [detection] = process(record).detections
    assert 10 * np.log10(detection.power_w / echo.power_w) == pytest.approx(0, abs=0.05)


@pytest.mark.parametrize(("noise_db", "size_rad"), [(65.0, 0.1), (45.0, np.pi)])
def test_phases_of_separate_oscillators_are_removed(noise_db: float, size_rad: float) -> None:
    """Random from slot to slot, read from the leakage: an echo 15 dB below it is as strong as with
    one oscillator, within 0.3 dB, and is all there is.
    """
    echo = Echo((5.0, 0, 0), 10**-1.5, (5.3, 0, 0))
    noise_w = 10 ** (-noise_db / 10) * WIDE.n_subcarriers * WIDE.n_slots
    record = cube(WIDE, [echo], noise_w=noise_w, leakage=(1.0, 1e-9))
    x = complex_samples(record.iq)
    turned = x * np.exp(1j * np.random.default_rng(1).uniform(-size_rad, size_rad, (64, 1, 1)))
    parts = np.rint(np.stack([turned.real, turned.imag], axis=-1)).astype(np.int16)
    [detection] = process(replace(record, iq=parts)).detections
    assert 10 * np.log10(detection.power_w / echo.power_w) == pytest.approx(0, abs=0.3)


def test_leakage_of_each_transmitter_has_its_own_phase() -> None:
    """Two transmitters in turns whose leakage differs by 2 rad and 6 dB, 26 dB above an echo: where
    both counted as one, its azimuth had been off by 0.12 rad, a thousand standard errors.
    """
    target = [Echo((5.0, 1.5, 0.0))]
    plain = cube(WIDE, target, noise_w=1e-10, counts=300.0, **MIMO)
    scale = plain.front_end.root_watt_per_count
    delay_s = 3e-9
    offsets = WIDE.frequency_offsets_hz
    path = np.exp(-2j * np.pi * (WIDE.carrier_hz + offsets) * delay_s)
    wave = np.fft.ifft(np.fft.ifftshift(WIDE.sent() * path)) * np.sqrt(WIDE.n_subcarriers)
    level = np.where(plain.transmitter == 0, 1, 0.5 * np.exp(2j)) * 10**-3.2 / scale
    added = level[:, None, None] * wave
    iq = np.rint(plain.iq + np.stack([added.real, added.imag], axis=-1)).astype(np.int16)
    record = replace(calibrated(plain, leakage_delay_s=delay_s), iq=iq)
    found, alone = (process(one).detections[0] for one in (record, plain))
    assert abs(found.azimuth_rad - alone.azimuth_rad) < 4.5 * found.azimuth_error_rad
    assert found.azimuth_error_rad < 1e-3


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


@pytest.mark.parametrize("offset", [1, 2, 20, -500])
def test_an_offset_of_the_converters_changes_no_echo(offset: int) -> None:
    """Of some counts, in noise of ten: it looks like an image as strong as the signal. 2 counts
    had taken it up by some dB; 20 were refused.
    """
    record = cube(WIDE, [Echo((6.0, 0, 0), 1e-12)], noise_w=1e-11, counts=40)
    due = process(record).detections[0]
    shifted = replace(record, iq=record.iq + np.int16(offset))
    got = process(shifted).detections[0]
    assert got.power_w == pytest.approx(due.power_w, rel=1e-3)
    assert got.range_m == pytest.approx(due.range_m, abs=0.1 * due.range_error_m)
    x = complex_samples(shifted.iq[0])
    assert ratio(list(x), WIDE) == 0


def with_faults(record, offset: complex, gain_db: float = 0.0, drift: float = 0.0):
    """The record of branches that differ in gain, with an offset in counts that changes by
    ``drift`` of it over the burst.
    """
    course = 1 + drift * np.linspace(-0.5, 0.5, record.iq.shape[2])[:, None, None, None]
    parts = record.iq * np.array([10 ** (gain_db / 20), 1.0])
    parts += course * np.array([np.real(offset), np.imag(offset)])
    return replace(record, iq=np.rint(parts).astype(np.int16))


@pytest.mark.parametrize(("offset", "gain_db"), [(30j, 0.3), (20 + 300j, 1.0), (300, 3.0)])
def test_echoes_at_rest_outlive_offset_and_image_of_strong_leakage(offset, gain_db) -> None:
    """Leakage of 95 dB, an echo at rest of 40, noise of 18 counts: the level within 0.4 dB (five
    standard errors). Delays where the offset happened to cancel the image had counted as quiet:
    the image stayed, and the echo was lost in it.
    """
    noise_w = 10**-9.5 * WIDE.n_subcarriers * WIDE.n_slots
    echo = Echo((3.0, 0, 0), 10**-5.5)
    record = cube(WIDE, [echo], noise_w=noise_w, leakage=(1.0, 0.3e-9))
    frame = process(with_faults(record, offset, gain_db))
    assert len(frame.detections) == 1
    assert not frame.warnings
    gain = abs((10 ** (gain_db / 20) + 1) / 2) ** 2
    level_db = 10 * np.log10(frame.detections[0].power_w / echo.power_w / gain)
    assert level_db == pytest.approx(0, abs=0.4)


@pytest.mark.parametrize("symbols", ["zadoff-chu", "flat"])
def test_an_offset_far_above_echoes_hides_none_of_them(symbols) -> None:
    """Of 50 times the noise; 45 and 26 dB at rest. Levels of 8 records are as without an offset
    within a third of their errors, rms; what was found had been off by 2, and weak ones were lost.
    """
    wave = replace(WIDE, n_subcarriers=64, symbols=symbols)
    changes = []
    for seed in range(8):
        places = 1 + 0.11 * seed, 4 + 0.05 * seed
        echoes = [Echo((r, 0, 0), p) for r, p in zip(places, (1e-9, 10**-10.9), strict=True)]
        record = cube(wave, echoes, noise_w=64 * 64 * 10**-13.5, counts=100, seed=seed)
        due, got = (process(r).detections for r in (record, with_faults(record, 800 - 600j)))
        assert len(due) == len(got) == 2
        changes += [
            (b.power_w - a.power_w) / a.power_error_w for a, b in zip(due, got, strict=True)
        ]
    assert np.sqrt(np.mean(np.square(changes))) < 1 / 3


def test_an_offset_that_drifts_hides_no_slow_echo() -> None:
    """By a fifth of 100 times the noise within the burst; 28 dB, two cells of rate from rest."""
    echo = Echo((3.0, 0, 0), 1e-9, (2 * WIDE.velocity_cell_m_per_s, 0, 0))
    noise_w = echo.power_w * 10**-2.8 * WIDE.n_subcarriers * WIDE.n_slots
    record = cube(WIDE, [echo], noise_w=noise_w, counts=40)
    due = process(record).detections[0]
    frame = process(with_faults(record, 1000, drift=0.2))
    assert not frame.warnings
    assert frame.detections[0].power_w == pytest.approx(due.power_w, abs=due.power_error_w / 2)


def test_branches_alike_by_rounding_alone_are_processed() -> None:
    """A tenth of a count of noise about the middle between two codes: I has both, Q one."""
    parts = np.random.default_rng(0).normal(0, 0.1, (1, 1, 64, 1, 256, 2)) + np.array([0.5, 0.0])
    record = replace(cube(WIDE, []), iq=np.rint(parts).astype(np.int16))
    assert not process(record).detections
    with pytest.raises(InputError, match="I and Q depend on each other"):
        process(replace(record, iq=50 * record.iq))


@pytest.mark.parametrize(
    ("counts", "fault"),
    [
        ((12, 12), "receiver 0: all samples are the same"),
        ((32767, 32767), "receiver 0: all samples are the same"),
        ((12, 0), "receiver 0: all samples are the same"),
        ((0, 0), None),
    ],
)
def test_samples_that_are_constant_are_told(counts: tuple[int, int], fault: str | None) -> None:
    """A receiver that is stuck, or a converter at its rail; of silence there is nothing to tell."""
    record = cube(WIDE, [], noise_w=1e-10)
    stuck = replace(record, iq=np.broadcast_to(np.array(counts, np.int16), record.iq.shape).copy())
    if fault is None:
        assert not process(stuck).detections
        return
    with pytest.raises(InputError, match=fault):
        process(stuck)


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
