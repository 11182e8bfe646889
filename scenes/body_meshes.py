"""Meshes of a car and a person whose radar echo at 79 GHz is near that of real ones.

A smooth low-polygon body answers a radar only where a facet faces it. What makes a car bright are
curved panels, recesses with walls at right angles (grille, lamps, the plate's niche), rims and
wheel houses; a person's clothes fold. Smooth surfaces keep their facets within a sixteenth of a
wavelength at 79 GHz. docs/bodies.md compares the cross-sections with published ones.
"""

import numpy as np
import trimesh
from scipy.interpolate import PchipInterpolator
from scipy.spatial import Delaunay

SAGITTA_M = 299_792_458.0 / 79e9 / 16  # between a facet and the surface that it stands for


def join(*parts):
    return trimesh.util.concatenate(list(parts))


def box(lo, hi):
    return trimesh.creation.box(bounds=[lo, hi])


def chord(radius_m):
    """Longest facet along a surface of this radius of curvature."""
    return (8 * radius_m * SAGITTA_M) ** 0.5


def loft(rings):
    """Closed body through rings (n, m, 3); each end is closed by a fan about its centre."""
    n, m, _ = rings.shape
    i, j = np.meshgrid(np.arange(n - 1), np.arange(m), indexing="ij")
    a, b = i * m + j, i * m + (j + 1) % m
    sides = np.stack([np.stack([a, b, b + m], -1), np.stack([a, b + m, a + m], -1)])
    k = np.arange(m)
    first, last = n * m, n * m + 1
    fans = [
        np.stack([np.full(m, first), (k + 1) % m, k], -1),
        np.stack([np.full(m, last), (n - 1) * m + k, (n - 1) * m + (k + 1) % m], -1),
    ]
    ends = [rings[0].mean(0), rings[-1].mean(0)]
    mesh = trimesh.Trimesh(
        np.vstack([rings.reshape(-1, 3), ends]),
        np.vstack([sides.reshape(-1, 3), *fans]),
        process=False,
    )
    if mesh.volume < 0:
        mesh.invert()
    return mesh


def lathe_y(profile, around):
    """Closed body of revolution about y from (y, radius) pairs, with a flat end each."""
    phi = np.linspace(0, 2 * np.pi, around, endpoint=False)
    flat = np.stack([np.cos(phi), 0 * phi, np.sin(phi)], -1)
    return loft(np.stack([r * flat + [0, y, 0] for y, r in profile]))


def ring_y(profile, around):
    """Closed ring about y from the (y, radius) pairs of its section."""
    body = lathe_y([*profile, profile[0]], around)
    n = around * len(profile)
    faces = body.faces[: 2 * n] % n  # without the ends; the last section is the first
    return trimesh.Trimesh(body.vertices[:n], faces, process=False)


# ---------------------------------------------------------------- car

LENGTH, HALF_WIDTH = 3.4, 0.74  # x from the rear, y to the left, z up
FLOOR, SHOULDER, NOSE = 0.21, 0.93, 0.84  # NOSE: height over the floor in front over that behind
BULGE = (0.58, 6.0)  # height where the sides stand upright, and their radius of curvature
EDGE = 0.025  # radius of the lower and the upper edge
# Radius and angle in deg of the arcs from the middle of the rear round to that of the front.
OUTLINE = ((2.5, 11.5), (0.20, 73.8), (16.0, 9.4), (0.20, 71.0), (1.8, 14.3))
CABIN = ((2.5, 13.0), (0.06, 70.0), (10.0, 12.0), (0.06, 68.0), (2.0, 17.0))
AXLES, WHEEL, TRACK = (0.58, 2.78), 0.30, 0.62
HOUSE, HOUSE_INNER = 0.345, 0.49  # radius of a wheel house, and where it ends within
DRAFT = 0.0006  # of a recess, from its rim to its ground

# Recesses of the half with y > 0: where along the outline (m from its middle behind; negative: from
# its middle in front), heights, depth.
GRILLE = [
    ((-y - 0.11, -y), z, 0.05) for y in (0.03, 0.152, 0.274) for z in ((0.34, 0.40), (0.42, 0.48))
]
REAR = [
    ((0.0, 0.27), (0.48, 0.62), 0.03),
    *(((s, s + 0.08), (0.34, 0.40), 0.045) for s in (0.540, 0.627)),
]
LAMPS = [
    *(((-s - 0.09, -s), (0.62, 0.71), 0.055) for s in (0.47, 0.572)),
    *(((s, s + 0.08), z, 0.05) for s in (0.540, 0.627) for z in ((0.62, 0.71), (0.73, 0.81))),
]
DOORS = [((s, s + 0.005), (0.25, 0.89), 0.012) for s in (1.86, 2.80)]


class Outline:
    """Smooth closed curve of arcs, symmetric about x; its half with y > 0 from behind to front."""

    def __init__(self, arcs, length, half_width):
        self.arcs = arcs
        angle = np.radians([a for _, a in arcs])
        radius = np.array([r for r, _ in arcs])
        self.ends = np.concatenate([[0], np.cumsum(radius * angle)])
        s = np.linspace(0, self.ends[-1], 20001)
        heading = np.interp(s, self.ends, np.concatenate([[0], np.cumsum(angle)]))
        heading *= np.pi / heading[-1]
        # From the middle behind, driving to the left, then forwards, then back to the middle.
        step = np.stack([np.sin(heading), np.cos(heading)], -1)
        mean = (step[1:] + step[:-1]) / 2 * np.diff(s)[:, None]
        at = np.vstack([[0, 0], np.cumsum(mean, axis=0)])
        at[:, 1] -= at[-1, 1] * s / s[-1]
        scale = np.array([length / at[-1, 0], half_width / at[:, 1].max()])
        self.s, self.at = s, at * scale
        normal = np.stack([-np.cos(heading), np.sin(heading)], -1) / scale
        self.normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)

    @property
    def length(self):
        """Of the half."""
        return self.ends[-1]

    def __call__(self, s):
        """Points and outward normals, (n, 2) each."""
        return tuple(
            np.stack([np.interp(s, self.s, v[:, k]) for k in (0, 1)], -1)
            for v in (self.at, self.normal)
        )

    def along(self, x):
        """Arc length where the left side has this x."""
        return np.interp(x, self.at[:, 0], self.s)

    def columns(self):
        """As many points as the curvature asks for."""
        parts = [
            np.linspace(lo, hi, int(np.ceil((hi - lo) / chord(radius))) + 1)
            for (radius, _), lo, hi in zip(self.arcs, self.ends[:-1], self.ends[1:], strict=True)
        ]
        return np.unique(np.round(np.concatenate(parts), 6))


def rounded(n):
    """Quarter circle of an edge but for the last 18 deg: inset and drop from the side, (n,)."""
    a = np.linspace(0, np.radians(72), n)
    return EDGE * (1 - np.cos(a)), EDGE * np.sin(a)


def profile():
    """Inset and height of the side from the floor to the shoulder, (n,) each."""
    inset, drop = rounded(6)
    low, high = FLOOR + EDGE, SHOULDER - EDGE
    middle = np.linspace(low, high, int(np.ceil((high - low) / chord(BULGE[1]))) + 1)[1:-1]
    z = np.concatenate([low - drop[::-1], middle, high + drop])
    d = np.concatenate([inset[::-1], 0 * middle, inset])
    return d + (z - BULGE[0]) ** 2 / (2 * BULGE[1]), z


class Side:
    """The left half of the lower body over (s along the outline, height before the nose drops)."""

    def __init__(self):
        self.outline = Outline(OUTLINE, LENGTH, HALF_WIDTH)
        self.inset, self.z = profile()

    def __call__(self, s, z, depth=0.0):
        """Points (..., 3), recessed by a depth."""
        at, normal = self.outline(s)
        inward = np.interp(z, self.z, self.inset) + depth
        xy = at - inward[..., None] * normal
        drop = 1 - (1 - NOSE) * at[..., 0] / LENGTH
        return np.concatenate([xy, (FLOOR + (z - FLOOR) * drop)[..., None]], -1)

    def height(self, s, z_shown):
        """Height before the nose drops of a height that is seen."""
        drop = 1 - (1 - NOSE) * self.outline(s)[0][..., 0] / LENGTH
        return FLOOR + (z_shown - FLOOR) / drop


def widened(places, bounds):
    """Places with two more at each bound: the rim of a recess, and the ground's edge."""
    for lo, hi in bounds:
        places = places[(places < lo - DRAFT) | (places > lo + 2 * DRAFT)]
        places = places[(places < hi - 2 * DRAFT) | (places > hi + DRAFT)]
        places = np.concatenate([places, [lo, lo + DRAFT, hi - DRAFT, hi]])
    return np.unique(np.round(places, 7))


def lower_body():
    """Closed but for the wheel houses' undersides; with recesses, doors' gaps and wheel houses."""
    side = Side()
    end = side.outline.length
    recesses = [
        (tuple(np.where(np.less(s, 0), np.add(s, end), s)), z, depth)
        for s, z, depth in GRILLE + REAR + LAMPS + DOORS
    ]
    s = widened(side.outline.columns(), sorted({along for along, _, _ in recesses}))
    z = widened(side.z, sorted({height for _, height, _ in recesses}))
    depth = np.zeros((len(s), len(z)))
    for (lo, hi), (low, high), deep in recesses:
        lo = lo or -1.0  # a niche across the middle has no wall there
        inside = np.outer(
            (s > lo + DRAFT / 2) & (s < hi - DRAFT / 2),
            (z > low + DRAFT / 2) & (z < high - DRAFT / 2),
        )
        depth[inside] = deep
    grid = side(*np.meshgrid(s, z, indexing="ij"), depth)
    index = np.arange(grid[..., 0].size).reshape(grid.shape[:2])
    keep = np.ones((len(s) - 1, len(z) - 1), bool)
    parts, feet = [], []
    for axle in AXLES:
        patch, cut, foot = wheel_house(side, s, z, axle)
        keep[cut] = False
        parts.append(patch)
        feet.append(foot)
    a, b = index[:-1, :-1], index[1:, :-1]
    c, d = index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1)[keep], np.stack([a, c, d], -1)[keep]])
    parts.append(trimesh.Trimesh(grid.reshape(-1, 3), faces, process=False))
    parts += [floor(grid[:, 0], feet), lid(grid[:, -1])]
    half = join(*parts)
    other = half.copy()
    other.vertices[:, 1] *= -1
    other.faces = other.faces[:, ::-1]
    return join(half, other)


def wheel_house(side, s, z, axle):
    """Of one wheel: patch of the side around the arch with the house; grid's cells that it
    replaces; and the house's outline on the floor.
    """
    lo, hi = (side.outline.along(axle + k * (HOUSE + 0.03)) for k in (-1, 1))
    i, j = np.searchsorted(s, lo) - 1, np.searchsorted(s, hi)
    top = np.searchsorted(z, side.height(hi, np.array(WHEEL + HOUSE + 0.03)))
    reach = np.arccos(np.clip((WHEEL - FLOOR) / HOUSE, -1, 1))
    angle = np.linspace(reach - np.pi, np.pi - reach, 2 * int(np.pi * HOUSE / chord(HOUSE) / 2) + 1)
    arch_x, arch_z = axle + HOUSE * np.sin(angle), WHEEL + HOUSE * np.cos(angle)
    arch_z[[0, -1]] = FLOOR
    arch_s = side.outline.along(arch_x)
    arch = np.stack([arch_s, side.height(arch_s, arch_z)], -1)
    grid = np.stack(np.meshgrid(s[i : j + 1], z[: top + 1], indexing="ij"), -1).reshape(-1, 2)
    x = side.outline(grid[:, 0])[0][:, 0]
    shown = side(grid[:, 0], grid[:, 1])[:, 2]
    clear = np.hypot(x - axle, shown - WHEEL) > HOUSE + 0.006
    points = np.vstack([grid[clear], arch])
    faces = Delaunay(points).simplices
    middle = points[faces].mean(axis=1)
    x = side.outline(middle[:, 0])[0][:, 0]
    shown = side(middle[:, 0], middle[:, 1])[:, 2]
    faces = faces[np.hypot(x - axle, shown - WHEEL) > HOUSE * np.cos(np.pi / len(angle))]
    patch = trimesh.Trimesh(side(points[:, 0], points[:, 1]), faces, process=False)
    patch.update_faces(patch.area_faces > 1e-9)
    rim = side(arch[:, 0], arch[:, 1])
    inner = np.column_stack([rim[:, 0], np.full(len(rim), HOUSE_INNER), rim[:, 2]])
    n, k = len(rim), np.arange(len(rim) - 1)
    tunnel = np.vstack([np.stack([k, k + 1, n + k + 1], -1), np.stack([k, n + k + 1, n + k], -1)])
    wall = np.stack([np.full(n - 1, 2 * n), n + k, n + k + 1], -1)
    hub = np.array([[axle, HOUSE_INNER, FLOOR]])
    house = trimesh.Trimesh(np.vstack([rim, inner, hub]), np.vstack([tunnel, wall]), process=False)
    foot = (rim[0, 0], rim[-1, 0])
    return join(patch, house), np.ix_(np.arange(i, j), np.arange(top)), foot


def floor(rim, feet):
    """Underside of the left half; open under the wheel houses."""
    points = [rim, rim * [1, 0, 1]]
    for lo, hi in feet:
        x = np.linspace(lo, hi, 9)
        y = np.linspace(HOUSE_INNER, np.interp((lo + hi) / 2, rim[:, 0], rim[:, 1]), 5)
        points.append(np.column_stack([x, 0 * x + HOUSE_INNER, 0 * x + FLOOR]))
        for end in (lo, hi):
            points.append(np.column_stack([0 * y + end, y, 0 * y + FLOOR]))
    points = np.unique(np.round(np.vstack(points), 5), axis=0)
    faces = Delaunay(points[:, :2]).simplices
    middle = points[faces].mean(axis=1)
    for lo, hi in feet:
        inside = (middle[:, 0] > lo) & (middle[:, 0] < hi) & (middle[:, 1] > HOUSE_INNER)
        faces, middle = faces[~inside], middle[~inside]
    return trimesh.Trimesh(points, faces, process=False)


def lid(rim):
    """The flat top of the left half, under the cabin: bonnet and boot."""
    k = np.arange(len(rim) - 1)
    mesh = trimesh.Trimesh(
        np.vstack([rim, rim * [1, 0, 1]]),
        np.vstack(
            [
                np.stack([k, k + 1, len(rim) + k + 1], -1),
                np.stack([k, len(rim) + k + 1, len(rim) + k], -1),
            ]
        ),
        process=False,
    )
    mesh.update_faces(mesh.area_faces > 1e-9)
    return mesh


def cabin_rings():
    """Rings (levels, columns, 3) from within the lower body to the edge of the roof."""
    knots = np.array(  # z, x behind, x in front, half width
        [
            [0.80, 0.06, 2.78, 0.70],
            [0.95, 0.10, 2.52, 0.665],
            [1.15, 0.22, 2.22, 0.62],
            [1.32, 0.34, 1.96, 0.575],
            [1.40, 0.43, 1.83, 0.545],
        ]
    )
    z = np.linspace(0.80, 1.38, 9)
    inset, drop = rounded(5)
    z = np.concatenate([z, 1.40 + drop])
    shape = PchipInterpolator(knots[:, 0], knots[:, 1:])(np.minimum(z, 1.40))
    inset = np.concatenate([np.zeros(9), inset])
    rings = []
    for level, (behind, front, half), d in zip(z, shape, inset, strict=True):
        outline = Outline(CABIN, front - behind - 2 * d, half - d)
        at = outline(outline.columns())[0]
        at = np.vstack([at, (at * [1, -1])[-2:0:-1]])
        rings.append(np.column_stack([at[:, 0] + behind + d, at[:, 1], np.full(len(at), level)]))
    return np.array(rings)


def pane(rings, normals, levels, columns, out=0.004):
    """Closed thin slab over a rectangle of the cabin's grid, standing proud of it by `out`."""
    ij = np.ix_(levels, columns)
    outer, inner = rings[ij] + out * normals[ij], rings[ij] - out * normals[ij]
    return loft(np.concatenate([outer, inner[:, ::-1]], axis=1))


def cabin():
    """Cabin and its windows."""
    rings = cabin_rings()
    n, m, _ = rings.shape
    body = loft(rings)
    normals = body.vertex_normals[: n * m].reshape(n, m, 3)
    half = Outline(CABIN, 1.0, 0.5)
    s = half.columns()
    ends = half.ends
    levels = np.arange(3, 9)
    behind = np.flatnonzero(s < ends[1])
    front = np.flatnonzero(s > ends[4])
    flank = np.flatnonzero((s >= ends[2] - 1e-6) & (s <= ends[3] + 1e-6))
    middle = len(flank) // 2
    sides = [flank[: middle + 1], flank[middle + 1 :]]
    sides = [w for w in sides if len(w) > 1]
    mirrored = [(m - w[::-1]) % m for w in sides]
    across = [
        np.concatenate([(m - behind[:0:-1]) % m, behind]),
        np.concatenate([front, m - front[-2::-1]]),
    ]
    return body, join(*(pane(rings, normals, levels, w) for w in sides + mirrored + across))


TYRE = [
    (0.060, 0.20),
    (0.085, 0.21),
    (0.095, 0.25),
    (0.080, 0.30),
    (-0.080, 0.30),
    (-0.085, 0.20),
]
# Hub, brake disc at the ground of the rim, barrel, flange, back.
RIM = [
    (0.045, 0.035),
    (-0.020, 0.035),
    (-0.020, 0.189),
    (0.068, 0.190),
    (0.075, 0.200),
    (0.060, 0.206),
    (-0.080, 0.195),
    (-0.080, 0.050),
]
SPOKES = 5


def wheel():
    """Tyre and rim about the y axis, outer side towards +y."""
    tyre = ring_y(TYRE, 80)
    rim = [lathe_y(RIM, 64)]
    for k in range(SPOKES):
        spoke = box([0.030, 0.018, -0.018], [0.188, 0.043, 0.018])
        turn = trimesh.transformations.rotation_matrix(2 * np.pi * (k + 0.25) / SPOKES, [0, 1, 0])
        rim.append(spoke.apply_transform(turn))
    return tyre, join(*rim)


def mirror(sign):
    """Door mirror: half an ellipsoid, its flat side to the rear."""
    angle = np.linspace(0, 1.45, 9)
    phi = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    circle = np.stack([0 * phi, np.cos(phi), np.sin(phi)], -1)
    half = loft(np.array([np.cos(a) * circle + [np.sin(a), 0, 0] for a in angle]))
    return half.apply_scale([0.10, 0.10, 0.065]).apply_translation([2.12, sign * 0.80, 0.98])


def plate(x, way):
    """Number plate, bent with the car's end (2.5 m) and leaning back by 3 deg; way: outwards."""
    section = np.array([(-0.003, -0.055), (0.003, -0.055), (0.003, 0.055), (-0.003, 0.055)])
    y = np.linspace(-0.26, 0.26, 9)
    slab = loft(np.array([np.insert(section, 1, side, axis=1) for side in y]))
    x_y_z = slab.vertices
    x_y_z[:, 0] -= way * (x_y_z[:, 1] ** 2 / 5.0 + x_y_z[:, 2] * np.tan(np.radians(3)))
    slab.vertices = x_y_z
    return slab.apply_translation([x, 0, 0.54])


def car():
    """Parts in the car's frame: x forward from the rear, z from the ground."""
    upper, windows = cabin()
    wheels, rims = [], []
    for x in AXLES:
        for sign in (1, -1):
            for part, into in zip(wheel(), (wheels, rims), strict=True):
                if sign < 0:
                    part.apply_transform(trimesh.transformations.rotation_matrix(np.pi, [0, 0, 1]))
                into.append(part.apply_translation([x, sign * TRACK, WHEEL]))
    return {
        "car": join(lower_body(), upper, mirror(1), mirror(-1)),
        "car_windows": windows,
        "car_wheels": join(*wheels),
        "car_rims": join(*rims),
        "car_plate": join(plate(0.018, -1), plate(3.408, 1)),
    }


# ---------------------------------------------------------------- person


def limb(path, radii, flat=(1.0, 1.0), around=24, fold=None, phase=0.0):
    """Smooth tube along a path with round ends; flat scales x and y of the sections.

    ``fold`` is the height and the length of the folds of clothes around it.
    """
    path, radii = np.asarray(path, float), np.asarray(radii, float)
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    height, length = fold or (0.0, 0.5)
    step = chord(length**2 / (4 * np.pi**2 * height)) if fold else 0.04
    fine = np.linspace(0, along[-1], max(int(np.ceil(along[-1] / step)) + 1, 4))
    centre = PchipInterpolator(along, path)(fine)
    radius = PchipInterpolator(along, radii)(fine)
    first, last = np.radians([20, 55]), np.radians([65, 40, 15])  # the first end is hidden
    start, stop = path[1] - path[0], path[-1] - path[-2]
    start, stop = start / np.linalg.norm(start), stop / np.linalg.norm(stop)
    squash = 0.6
    head = centre[0] - squash * radii[0] * np.cos(first)[:, None] * start
    tail = centre[-1] + squash * radii[-1] * np.cos(last)[:, None] * stop
    phi = np.linspace(0, 2 * np.pi, around, endpoint=False)
    # Oblique folds that come and go along the limb.
    wave = 2 * np.pi * fine[:, None] / length + phase
    swell = height * np.sin(np.pi * fine / along[-1])[:, None]
    folded = radius[:, None] + swell * (
        0.7 * np.sin(wave + 2 * phi) + 0.5 * np.sin(0.6 * wave - phi + 1.7 * phase)
    )
    radius = np.vstack(
        [
            np.tile((radii[0] * np.sin(first))[:, None], around),
            folded,
            np.tile((radii[-1] * np.sin(last))[:, None], around),
        ]
    )
    centre = np.vstack([head, centre, tail])
    ring = np.stack([flat[0] * np.cos(phi), flat[1] * np.sin(phi), 0 * phi], -1)
    return loft(centre[:, None] + radius[..., None] * ring)


def person():
    """A standing figure of 1.75 m that faces -x: clothes, and head with hands."""
    torso = limb(
        [(0, 0, 0.86), (0, 0, 0.95), (0, 0, 1.10), (0, 0, 1.25), (-0.01, 0, 1.38), (0, 0, 1.45)],
        [0.145, 0.165, 0.150, 0.170, 0.175, 0.110],
        flat=(0.66, 1.0),
        around=50,
        fold=(0.004, 0.22),
    )
    cloth, skin = [torso], []
    for s in (1, -1):
        cloth.append(
            limb(
                [(0.01, s * 0.09, 0.88), (0, s * 0.095, 0.50), (0.015, s * 0.10, 0.12)],
                [0.088, 0.064, 0.055],
                around=36,
                fold=(0.004, 0.32),
                phase=1.0 + s,
            )
        )
        foot = trimesh.creation.icosphere(subdivisions=2).apply_scale([0.135, 0.05, 0.05])
        cloth.append(foot.apply_translation([-0.05, s * 0.105, 0.05]))
        cloth.append(
            limb(
                [(0, s * 0.175, 1.39), (0.01, s * 0.205, 1.12), (-0.03, s * 0.215, 0.87)],
                [0.058, 0.047, 0.036],
                around=28,
                fold=(0.003, 0.27),
                phase=2.0 - s,
            )
        )
        skin.append(
            limb(
                [(-0.033, s * 0.216, 0.845), (-0.045, s * 0.216, 0.755)],
                [0.028, 0.034],
                flat=(1.1, 0.6),
                around=20,
            )
        )
    skin.append(limb([(0, 0, 1.43), (-0.005, 0, 1.56)], [0.055, 0.052], around=32))
    head = trimesh.creation.icosphere(subdivisions=3)
    skin.append(head.apply_scale([0.098, 0.076, 0.118]).apply_translation([-0.01, 0, 1.632]))
    return {"person": join(*cloth), "person_head": join(*skin)}
