"""The same results as other people's libraries.

The light ones are installed with the tests; those of the extra ``peers`` by `make test-peers`,
where one that is missing is a failure.
"""

from typing import Any

import numpy as np
import pytest
from scipy.linalg import hadamard

from hardware import PatternSet
from hardware.patterns import fwht
from hardware.radar import Cfar, Detection, OfdmWaveform, cfar_threshold, range_doppler
from hardware.radar.detection import detect_echoes
from hardware.reconstruction import Sensing
from hardware.reconstruction.cosine import dct_matrix
from hardware.reconstruction.dictionaries import prior_deviation
from hardware.reconstruction.methods import fista

pytestmark = pytest.mark.filterwarnings("ignore")  # of the peers' own making


@pytest.mark.peers
def test_the_transform_is_spyrits() -> None:
    import spyrit.core.torch as theirs
    import torch

    x = np.random.default_rng(0).normal(size=1024)
    found = theirs.fwht(torch.asarray(x), order=False).numpy()
    np.testing.assert_allclose(fwht(x), found, atol=1e-10)


@pytest.mark.peers
def test_the_walsh_order_is_spyrits() -> None:
    import spyrit.core.torch as theirs

    h = 2.0 * PatternSet(1, 64, 64, "walsh", "plain").masks().reshape(64, 64) - 1
    np.testing.assert_array_equal(h, theirs.walsh_matrix(64).numpy())


@pytest.mark.peers
def test_split_measurements_are_spyrits() -> None:
    """Pattern and complement, one after the other: rows of their split operator."""
    import torch
    from spyrit.core import meas

    operator = meas.HadamSplit2d(8, dtype=torch.float64)
    picture = np.random.default_rng(1).random((8, 8))
    theirs = operator.measure(torch.asarray(picture)[None, None]).numpy().ravel()
    ours = PatternSet(8, 8, 64, "natural").signal(picture.ravel())
    np.testing.assert_allclose(np.sort(ours), np.sort(theirs), atol=1e-9)
    np.testing.assert_allclose(
        np.sort(ours[0::2] - ours[1::2]), np.sort(theirs[0::2] - theirs[1::2]), atol=1e-9
    )


@pytest.mark.peers
def test_the_s_matrix_is_spyrits() -> None:
    """Rows and columns from 1 on, in Walsh order."""
    from spyrit.misc import walsh_hadamard

    s = PatternSet(1, 32, 32, "walsh", "s-matrix").masks().reshape(32, 32)
    np.testing.assert_array_equal(s[1:, 1:], walsh_hadamard.walsh_S_matrix(31))


@pytest.mark.peers
def test_known_motion_is_taken_out_better_than_by_spyrit() -> None:
    """A frame of 32 x 32 cells that moves by 4 cells down and 10 to the right: their warp of an
    image 8 cells wider, with the regularisation and strength that are best for it, against ours.
    """
    import torch
    from moving_scenes import AnalyticScene, moving_record, psnr
    from spyrit.core.inverse import PseudoInverse
    from spyrit.core.meas import DynamicLinearSplit
    from spyrit.core.warp import DeformationField

    from hardware import Shift, reconstruct
    from hardware.patterns import hadamard_rows

    n, beyond, down, right = 32, 8, 4.0, 10.0
    scene, patterns = AnalyticScene.of(3, n, 12.0), PatternSet(n, n, n * n, "interleaved")
    record = moving_record(
        lambda t: scene.cells(n, down * t, right * t).ravel(), patterns, noise=0.03
    )
    truth, side = scene.cells(n, 0.0, 0.0), n + 2 * beyond
    middle_ns = (record.device_time_ns[0] + record.device_time_ns[-1]) / 2
    time_s = 1e-9 * (record.device_time_ns - middle_ns)[:, None, None]
    cells = np.arange(side)
    field = np.empty((len(time_s), side, side, 2))
    field[..., 0] = 2 * (cells - right * time_s) / (side - 1) - 1
    field[..., 1] = 2 * (cells[:, None] - down * time_s) / (side - 1) - 1
    rows = torch.asarray(hadamard_rows(patterns.indices, n * n).astype(np.float32))
    theirs = DynamicLinearSplit(rows, time_dim=1, meas_shape=(n, n), img_shape=(side, side))
    theirs.build_dynamic_forward(DeformationField(torch.asarray(field.astype(np.float32))))
    light = record.electrons[:, 0] / 1e5
    values = torch.asarray((light[0::2] - light[1::2]).astype(np.float32))[None]
    inner = slice(beyond, -beyond)
    found = {
        (kind, strength): psnr(
            PseudoInverse(
                theirs,
                kind,
                store_H_pinv=True,
                reshape_output=False,
                eta=strength,
                **({"img_shape": (side, side)} if kind == "H1" else {}),
            )(values)
            .numpy()
            .reshape(side, side)[inner, inner],
            truth,
        )
        for kind in ("L2", "H1")
        for strength in (1.0, 10.0, 100.0, 300.0, 1000.0, 3000.0)
    }
    ours = psnr(reconstruct(record, motion=Shift(down, right)).image[0] / 1e5, truth)
    best = max(found, key=lambda key: found[key])
    print(f"spyrit {found[best]:.2f} dB ({best[0]}, {best[1]:g}), ours {ours:.2f} dB")
    assert ours > found[best] + 1


@pytest.mark.peers
@pytest.mark.parametrize(
    ("order", "mask"), [("zigzag", "zig_zag_mask"), ("cake-cutting", "cake_cutting_mask")]
)
@pytest.mark.parametrize("count", [1, 3, 10, 15, 36, 64])
def test_orders_are_deepinvs(order: Any, mask: str, count: int) -> None:
    """Their masks of the Hadamard plane hold as many patterns of each kind, ours or transposed.

    Zigzag: the same diagonals. Cake-cutting: the same numbers of pieces; ties are free.
    """
    from deepinv.physics import singlepixel

    theirs = getattr(singlepixel, mask)
    rows, columns = np.nonzero(np.asarray(theirs((1, 8, 8), count)).reshape(8, 8))
    changes_of = np.count_nonzero(np.diff(hadamard(8), axis=1), axis=1)
    down, along = changes_of[rows], changes_of[columns]
    images = 2 * PatternSet(8, 8, count, order, "plain").masks().astype(int) - 1
    changes = (
        [(np.diff(i[:, 0]) != 0).sum() for i in images],
        [(np.diff(i[0]) != 0).sum() for i in images],
    )
    ours_down, ours_along = map(np.array, changes)
    if order == "zigzag":
        np.testing.assert_array_equal(np.sort(down + along), np.sort(ours_down + ours_along))
    else:
        expected = np.sort((down + 1) * (along + 1))
        np.testing.assert_array_equal(expected, np.sort((ours_down + 1) * (ours_along + 1)))


@pytest.mark.library("pylops")
def test_fista_is_that_of_pylops() -> None:
    """The same minimum: pylops' plain l1 problem in coefficients over their prior deviation."""
    import pylops

    rng = np.random.default_rng(2)
    sensing, noise = Sensing(PatternSet(8, 8, 30)), 400.0
    y = sensing.forward(np.cumsum(rng.normal(size=64)) * 300) + noise * rng.normal(size=30)
    ours = fista.fista(y, noise**2, sensing, iterations=20000)[0]
    plan = fista.lmmse_plan(sensing)
    scale = plan.scale(y, noise**2)
    deviation = np.sqrt(scale) * prior_deviation("dct", 8, 8).ravel()
    synthesis = np.kron(dct_matrix(8), dct_matrix(8)).T
    structure = np.flatnonzero(sensing.patterns.indices != 0)  # the mean is not penalised
    matrix = (sensing.matrix @ (synthesis * deviation))[structure][:, 1:]
    # The step's threshold times the Lipschitz constant, twice for pylops' |r|^2 + eps |x|.
    strength = fista.threshold(noise**2, scale, 64.0, 64) * 64.0
    largest = np.linalg.norm(matrix, 2) ** 2
    found = pylops.optimization.sparsity.fista(
        pylops.MatrixMult(matrix), y[structure], niter=20000, eps=2 * strength,
        alpha=0.99 / largest, tol=0.0,
    )[0]  # fmt: skip
    theirs = (synthesis[:, 1:] * deviation[1:]) @ found + ours.mean()

    def objective(image: np.ndarray) -> float:
        coefficients = (synthesis.T @ image)[1:] / deviation[1:]
        misfit = np.sum((sensing.forward(image) - y)[structure] ** 2)
        return float(misfit / 2 + strength * np.abs(coefficients).sum())

    assert objective(ours) == pytest.approx(objective(theirs), rel=1e-6)
    np.testing.assert_allclose(ours, theirs, atol=1e-3 * np.ptp(ours))


@pytest.mark.peers
def test_the_same_cells_as_hermespys_cfar() -> None:
    """Cell averaging on the same map of noise and echoes, away from edges, where ours wraps."""
    from hermespy.radar import CFARDetector, RadarCube

    rng = np.random.default_rng(0)
    power = rng.exponential(size=(128, 64))
    power[rng.integers(20, 108, 12), rng.integers(20, 44, 12)] *= 60
    # Theirs counts slots first, and needs axes only to name its points.
    slots, ranges = np.arange(64.0), np.arange(128.0)
    cube = RadarCube(power.T[None], np.zeros((1, 2)), slots, ranges, 1e9)
    theirs = CFARDetector((5, 8), (2, 3), 1e-3).detect(cube)
    ours = power > cfar_threshold(power, Cfar(1e-3, "ca", (3, 2), (8, 5)))
    inside = np.zeros_like(ours)
    inside[11:-11, 7:-7] = True
    expected = sorted(power[ours & inside])
    assert len(expected) > 10
    found = {point.power for point in theirs.points}
    np.testing.assert_allclose(sorted(found & set(power[inside])), expected)


@pytest.mark.peers
@pytest.mark.parametrize(("range_m", "rate"), [(3.0, -80.0), (20.0, 30.0), (37.5, 0.0)])
def test_the_same_map_as_hermespys_ofdm_radar(range_m: float, rate: float) -> None:
    """Its transmitter, target channel, receiver and OFDM radar on the 79 GHz numerology (4 GHz; a
    quarter of the subcarriers, prefix as long as the symbol, 128 slots without pause).

    Our map of the channel that its modem demodulates is its radar's, cell by cell; our detection
    has its target's range to the half sample that its channel rounds delays to, and its rate. Its
    channel raises the frequency for a target that moves away, so rates and Doppler rows are turned
    over here.
    """
    from hermespy.channel import SingleTargetRadarChannel
    from hermespy.jcas import OFDMRadar
    from hermespy.modem import (
        ElementType,
        GridElement,
        GridResource,
        OFDMWaveform,
        PrefixType,
        SymbolSection,
    )
    from hermespy.simulation import SimulatedDevice

    n, spacing_hz, slots = 1024, 4 * 976.5625e3, 128
    ours = OfdmWaveform(79e9, n, spacing_hz, slots, 2 / spacing_hz, 1, 1 / spacing_hz)
    resource = GridResource(n, PrefixType.CYCLIC, 1.0, [GridElement(ElementType.DATA)])
    theirs = OFDMWaveform(
        [resource], [SymbolSection(slots, [0])], num_subcarriers=n, dc_suppression=False
    )
    device = SimulatedDevice(
        carrier_frequency=79e9, bandwidth=n * spacing_hz, oversampling_factor=1, seed=3
    )
    radar = OFDMRadar(theirs)
    device.add_dsp(radar)
    sent = device.transmit()
    channel = SingleTargetRadarChannel(range_m, 10.0, velocity=rate, seed=1)
    received = device.receive(channel.propagate(sent, device, device)).operator_receptions[0]

    signal = np.asarray(received.signal.view(np.ndarray))[0]
    symbols = theirs.place(sent.operator_transmissions[0].symbols).raw[0]
    ratio = (theirs.demodulate(signal, n * spacing_hz, 1).raw[0] / symbols).T
    image = range_doppler(ratio, ours, "boxcar")
    expected = received.cube.data[0][::-1].T ** 2
    np.testing.assert_allclose(
        image.power_w / image.power_w.max(), expected / expected.max(), atol=1e-12
    )
    found = Detection.of(detect_echoes(ratio, ours, image, Cfar(1e-6), "boxcar", 1)[0])
    assert found.range_m == pytest.approx(range_m, abs=ours.range_cell_m)
    assert -found.range_rate_m_per_s == pytest.approx(rate, abs=0.02)
