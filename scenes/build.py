"""Write the meshes and the chart texture of the scenes kept in this folder.

    python scenes/build.py

Axes follow REP 103 (x forward, y left, z up), in metres, in scene coordinates:
the rig stands at (0, 0, 1.2) and looks along +x over a square field of 20 deg.
Meshes are binary PLY with float32 vertices; every closed body is watertight with
outward normals. The XML and TOML files beside the meshes are written by hand. The
folder `bodies` holds a car and a person in their own frames (`body_meshes.py`).
"""

import struct
import zlib
from pathlib import Path

import body_meshes
import numpy as np
import trimesh

HERE = Path(__file__).resolve().parent

C = 299_792_458.0
CARRIER_HZ = 79e9
RIG = np.array([0.0, 0.0, 1.2])
RADAR = RIG + [0.0, 0.0, -0.3]

# Yard: where things stand. scene.toml repeats the positions a radar should find.
WALL_X, WALL_SIZE = 12.3, (0.25, 10.0, 3.0)
CAR_REAR, CAR_YAW_DEG, CAR_LENGTH, CAR_HALF_WIDTH = (8.2, 0.1), 17.0, 3.4, 0.74
PERSON_XY = (7.2, -0.97)
POSTS = {"post_left": (9.0, 1.51), "post_right": (10.5, -0.91)}
POST_RADIUS, POST_HEIGHT = 0.04, 1.2
TRIHEDRAL_APEX, TRIHEDRAL_RCS = np.array([5.6, -0.22, 1.5]), 10.0
CHART_CENTRE, CHART_SIDE, CHART_PIXELS = np.array([5.0, 0.49, 1.70]), 0.7, 512

# Table 1: id -> (slant range in m, azimuth in deg); every patch subtends the same angle.
PATCHES = {"patch_20": (2.0, 6.5), "patch_50": (4.5, 0.0), "patch_80": (10.0, -6.5)}
PATCH_DEG = 5.0
BACKDROP_X, BACKDROP_SIDE = 14.0, 8.0

RAIL_Z = 1.0  # figure 3: height of the rail and of the cylinders' middle


# ---------------------------------------------------------------- building blocks


def join(*parts):
    return trimesh.util.concatenate(list(parts))


def box(lo, hi):
    return trimesh.creation.box(bounds=[lo, hi])


def quad(corners):
    """Two triangles; the normal points to where the corners run anticlockwise."""
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


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


def limb(path, radii, flat=(1.0, 1.0), around=24):
    """Smooth tube along a path with round ends; flat scales x and y of the sections."""
    path, radii = np.asarray(path, float), np.asarray(radii, float)
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    fine = np.linspace(0, along[-1], 4 * len(path))
    centre = np.stack([np.interp(fine, along, path[:, k]) for k in range(3)], -1)
    radius = np.interp(fine, along, radii)
    # Round ends: hemispheres whose last ring stays open a little for the fan.
    cap = np.radians([8, 25, 45, 65])
    start, stop = path[1] - path[0], path[-1] - path[-2]
    start, stop = start / np.linalg.norm(start), stop / np.linalg.norm(stop)
    squash = 0.6
    head = centre[0] - squash * radii[0] * np.cos(cap)[:, None] * start
    tail = centre[-1] + squash * radii[-1] * np.cos(cap[::-1])[:, None] * stop
    centre = np.vstack([head, centre, tail])
    radius = np.concatenate([radii[0] * np.sin(cap), radius, radii[-1] * np.sin(cap[::-1])])
    phi = np.linspace(0, 2 * np.pi, around, endpoint=False)
    ring = np.stack([flat[0] * np.cos(phi), flat[1] * np.sin(phi), 0 * phi], -1)
    return loft(centre[:, None] + radius[:, None, None] * ring)


def cylinder(xy, radius, z0, z1, around=48):
    phi = np.linspace(0, 2 * np.pi, around, endpoint=False)
    circle = np.stack([xy[0] + radius * np.cos(phi), xy[1] + radius * np.sin(phi), 0 * phi], -1)
    return loft(np.stack([circle + [0, 0, z] for z in np.linspace(z0, z1, 5)]))


def lathe_y(profile, around=48):
    """Closed body of revolution about y from (y, radius) pairs."""
    phi = np.linspace(0, 2 * np.pi, around, endpoint=False)
    return loft(
        np.stack(
            [
                np.stack([r * np.cos(phi), np.full(around, y), r * np.sin(phi)], -1)
                for y, r in profile
            ]
        )
    )


# ---------------------------------------------------------------- yard


def ground(lo=(-15.0, -30.0), side=60.0, cells=12):
    k = np.arange(cells + 1) * side / cells
    x, y = np.meshgrid(lo[0] + k, lo[1] + k, indexing="ij")
    i, j = np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij")
    a = (i * (cells + 1) + j).ravel()
    b, c, d = a + cells + 1, a + cells + 2, a + 1
    faces = np.vstack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    return trimesh.Trimesh(np.stack([x, y, 0 * x], -1).reshape(-1, 3), faces, process=False)


def wall():
    depth, width, height = WALL_SIZE
    return box([WALL_X, -width / 2, 0], [WALL_X + depth, width / 2, height])


CAR_TOP = [
    (0, 0.80),
    (0.05, 0.93),
    (0.40, 1.38),
    (0.65, 1.44),
    (1.1, 1.47),
    (1.6, 1.45),
    (1.9, 1.39),
    (2.55, 0.99),
    (3.1, 0.88),
    (3.3, 0.80),
    (3.4, 0.66),
]
CAR_HALF = [(0, 0.64), (0.06, 0.70), (0.25, 0.74), (3.0, 0.74), (3.25, 0.68), (3.4, 0.56)]
CAR_BOTTOM = [(0, 0.30), (0.15, 0.24), (0.4, 0.21), (3.0, 0.21), (3.3, 0.26), (3.4, 0.30)]
CAR_SEGMENTS = (4, 2, 7, 8, 2, 5)  # points along each piece of half a cross section
CAR_WHEELS = [(0.58, 0.30), (2.78, 0.30)]  # axle x, radius


def car_grid():
    """Stations and cross sections of the body in the car's frame (x forward from the rear)."""
    knots = sorted({x for line in (CAR_TOP, CAR_HALF, CAR_BOTTOM) for x, _ in line})
    xs = np.unique(np.round(np.concatenate([knots, np.linspace(0, CAR_LENGTH, 40)]), 3))
    xs = xs[np.concatenate([[True], np.diff(xs) > 0.015])]
    rings = []
    for x in xs:
        top, half, low = (np.interp(x, *np.transpose(c)) for c in (CAR_TOP, CAR_HALF, CAR_BOTTOM))
        belt = min(0.90, top - 0.08)
        roof = half - 0.32 * (top - belt)
        corners = np.array(
            [
                (0, low),
                (0.9 * half, low),
                (half, low + 0.1),
                (half - 0.015, belt),
                (roof, top - 0.05),
                (0.86 * roof, top),
                (0, top),
            ]
        )
        line = [
            np.linspace(p, q, n, endpoint=False)
            for p, q, n in zip(corners[:-1], corners[1:], CAR_SEGMENTS)
        ]
        right = np.vstack(line + [corners[-1:]]) * [-1, 1]
        ring = np.vstack([right, right[-2:0:-1] * [-1, 1]])
        rings.append(np.column_stack([np.full(len(ring), x), ring]))
    return xs, np.array(rings)


def pane(rings, normals, stations, columns, out=0.004):
    """Closed thin slab over a rectangle of the body's grid, standing proud of it by `out`."""
    ij = np.ix_(stations, columns)
    outer, inner = rings[ij] + out * normals[ij], rings[ij] - out * normals[ij]
    # Each station gives one flat loop: along the outer face and back along the inner one.
    return loft(np.concatenate([outer, inner[:, ::-1]], axis=1))


def car():
    """Body, windows, wheels, rims and number plate in scene coordinates."""
    xs, rings = car_grid()
    n, m, _ = rings.shape
    body = loft(rings)
    normals = body.vertex_normals[: n * m].reshape(n, m, 3)
    cuts = np.cumsum((0,) + CAR_SEGMENTS)
    side = np.arange(cuts[3] + 1, cuts[4])  # between beltline and roof edge
    roof = np.arange(cuts[5] + 1, m - cuts[5])  # across the top
    between = lambda lo, hi: np.flatnonzero((xs >= lo - 1e-9) & (xs <= hi + 1e-9))
    panes = [
        pane(rings, normals, between(lo, hi), cols)
        for lo, hi in ((0.45, 1.15), (1.25, 2.1))
        for cols in (side, (m - side)[::-1])
    ]
    panes += [pane(rings, normals, between(lo, hi), roof) for lo, hi in ((0.09, 0.36), (1.95, 2.5))]

    tyre = [
        (0.060, 0.15),
        (0.070, 0.19),
        (0.085, 0.20),
        (0.095, 0.23),
        (0.095, 0.27),
        (0.080, 0.30),
        (-0.080, 0.30),
        (-0.095, 0.27),
        (-0.095, 0.15),
    ]
    disc = [(0.075, 0.05), (0.070, 0.08), (0.066, 0.185), (0.050, 0.185)]
    wheels, rims = [], []
    for x, radius in CAR_WHEELS:
        for sign in (1, -1):
            for profile, into in ((tyre, wheels), (disc, rims)):
                part = lathe_y([(sign * y, r) for y, r in profile])
                into.append(part.apply_translation([x, sign * (CAR_HALF_WIDTH - 0.075), radius]))

    place = trimesh.transformations.rotation_matrix(np.radians(CAR_YAW_DEG), [0, 0, 1])
    place[:2, 3] = CAR_REAR
    meshes = {
        "car": body,
        "car_windows": join(*panes),
        "car_wheels": join(*wheels),
        "car_rims": join(*rims),
        "car_plate": box([-0.006, -0.26, 0.48], [0.002, 0.26, 0.59]),
    }
    return {name: mesh.apply_transform(place) for name, mesh in meshes.items()}


def person():
    """A standing figure of 1.75 m that faces the rig: clothes, and head with hands."""
    torso = limb(
        [(0, 0, 0.86), (0, 0, 0.95), (0, 0, 1.10), (0, 0, 1.25), (0, 0, 1.38), (0, 0, 1.45)],
        [0.145, 0.165, 0.150, 0.170, 0.175, 0.110],
        flat=(0.66, 1.0),
        around=40,
    )
    cloth, skin = [torso], []
    for s in (1, -1):
        cloth.append(
            limb(
                [(0.01, s * 0.09, 0.88), (0, s * 0.095, 0.50), (0.01, s * 0.10, 0.12)],
                [0.088, 0.064, 0.055],
            )
        )
        foot = trimesh.creation.icosphere(subdivisions=2).apply_scale([0.135, 0.05, 0.05])
        cloth.append(foot.apply_translation([-0.05, s * 0.105, 0.05]))
        cloth.append(
            limb(
                [(0, s * 0.175, 1.39), (0.01, s * 0.205, 1.12), (-0.03, s * 0.215, 0.87)],
                [0.058, 0.047, 0.036],
            )
        )
        skin.append(
            limb(
                [(-0.033, s * 0.216, 0.845), (-0.045, s * 0.216, 0.755)],
                [0.028, 0.034],
                flat=(1.1, 0.6),
            )
        )
    skin.append(limb([(0, 0, 1.43), (-0.005, 0, 1.56)], [0.055, 0.052]))
    head = trimesh.creation.icosphere(subdivisions=3)
    skin.append(head.apply_scale([0.098, 0.076, 0.118]).apply_translation([-0.01, 0, 1.632]))
    meshes = {"person": join(*cloth), "person_head": join(*skin)}
    return {k: v.apply_translation([*PERSON_XY, 0]) for k, v in meshes.items()}


def trihedral():
    """Triangular trihedral of the wanted boresight RCS, opening towards the radar.

    The inner faces are three right isosceles triangles of leg a. The back is one apex
    4 mm behind, so the edges are sharp and no rim adds to the return.
    """
    wavelength = C / CARRIER_HZ
    leg = (3 * wavelength**2 * TRIHEDRAL_RCS / (4 * np.pi)) ** 0.25
    bore = (RADAR - TRIHEDRAL_APEX) / np.linalg.norm(RADAR - TRIHEDRAL_APEX)
    left = np.cross([0, 0, 1], bore)
    left /= np.linalg.norm(left)
    up = np.cross(bore, left)
    turn = np.radians([90, 210, 330])
    tips = leg * (
        bore / np.sqrt(3)
        + np.sqrt(2 / 3) * (np.cos(turn)[:, None] * left + np.sin(turn)[:, None] * up)
    )
    vertices = np.vstack([[0, 0, 0], tips, -0.004 * bore]) + TRIHEDRAL_APEX
    faces = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [4, 2, 1], [4, 3, 2], [4, 1, 3]]
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if mesh.volume < 0:
        mesh.invert()
    foot = TRIHEDRAL_APEX + 0.004 * bore
    stand = join(
        cylinder(foot[:2], 0.006, 0.012, foot[2] - 0.011, around=24),
        cylinder(foot[:2], 0.09, 0, 0.012),
    )
    return {"trihedral": mesh, "trihedral_stand": stand}


def chart():
    """The chart's plane, facing the rig, with its texture coordinates; and its stand.

    Mitsuba puts v = 0 at the top row of a bitmap.
    """
    x, y, z = CHART_CENTRE
    h = CHART_SIDE / 2
    plane = quad([[x, y + h, z - h], [x, y - h, z - h], [x, y - h, z + h], [x, y + h, z + h]])
    uv = np.column_stack(
        [(y + h - plane.vertices[:, 1]) / CHART_SIDE, (z + h - plane.vertices[:, 2]) / CHART_SIDE]
    )
    back = (x + 0.014, y)
    stand = join(cylinder(back, 0.010, 0.012, z + 0.2, around=24), cylinder(back, 0.15, 0, 0.012))
    return {"chart": (plane, uv), "chart_stand": stand}


def chart_texture():
    """Reflectance x 255: Siemens star, bars of five periods in two directions, ten greys."""
    n, dark, light, grey = CHART_PIXELS, 0.05, 0.95, 0.50
    image = np.full((n, n), grey)
    image[:8], image[-8:], image[:, :8], image[:, -8:] = (light,) * 4

    # Siemens star, 24 periods, smoothed by averaging 8 x 8 samples per pixel.
    size, spokes = 304, 24
    s = (np.arange(size * 8) + 0.5) / 8 - size / 2
    xx, yy = np.meshgrid(s, s)
    star = np.where(np.sin(spokes * np.arctan2(yy, xx)) > 0, light, dark)
    radius = np.hypot(xx, yy)
    star = np.where((radius < 4) | (radius > size / 2 - 4), grey, star)
    image[20 : 20 + size, 20 : 20 + size] = star.reshape(size, 8, size, 8).mean((1, 3))

    # Bars: periods of 64, 32, 16, 8 and 4 pixels; vertical bars, then horizontal ones.
    top = 20
    for period, height in ((64, 64), (32, 64), (16, 64), (8, 56), (4, 48)):
        k = np.arange(80)
        bars = np.where(k % period < period / 2, dark, light)
        image[top : top + height, 336:416] = bars[None, :]
        image[top : top + height, 420:500] = bars[:height, None]
        top += height + 2

    # Ten greys from 5 to 95 % along the bottom, darkest at the left.
    for i, value in enumerate(np.linspace(0.05, 0.95, 10)):
        image[344:492, 16 + 48 * i : 64 + 48 * i] = value
    return np.round(255 * image).astype(np.uint8)


def yard():
    posts = {name: cylinder(xy, POST_RADIUS, 0, POST_HEIGHT) for name, xy in POSTS.items()}
    return {
        "ground": ground(),
        "wall": wall(),
        **car(),
        **person(),
        **posts,
        **trihedral(),
        **chart(),
    }


# ---------------------------------------------------------------- table 1


def facing_square(centre, side, target):
    """Square about `centre`, its normal towards `target`, two edges level."""
    normal = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross([0, 0, 1], normal)
    right /= np.linalg.norm(right)
    up = np.cross(normal, right)
    h = side / 2
    return quad(
        [centre + h * (a * right + b * up) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    )


def table1():
    meshes = {"backdrop": facing_square(RIG + [BACKDROP_X, 0, 0], BACKDROP_SIDE, RIG)}
    for name, (distance, azimuth) in PATCHES.items():
        a = np.radians(azimuth)
        centre = RIG + distance * np.array([np.cos(a), np.sin(a), 0])
        side = 2 * distance * np.tan(np.radians(PATCH_DEG / 2))
        meshes[name] = facing_square(centre, side, RIG)
    return meshes


# ---------------------------------------------------------------- figure 3 of the paper


def cylinders(*sideways):
    """Upright, 0.9 m ahead; caption: radius 40 mm, height 114 mm."""
    radius, height = 0.040, 0.114
    low, high = RAIL_Z - height / 2, RAIL_Z + height / 2
    names = ("cylinder",) if len(sideways) == 1 else ("cylinder_left", "cylinder_right")
    return {
        name: cylinder((0.9, y), radius, low, high, around=96)
        for name, y in zip(names, sideways, strict=True)
    }


# ---------------------------------------------------------------- street

# scene.toml repeats the positions a radar should find.
STREET_WALL = ([25.0, -0.3, 0.0], [25.3, 9.7, 3.5])  # its near end just right of the radar
STREET_CAR = (38.0, -1.5)  # middle of its rear
STREET_PERSON = (18.0, -2.5)
STREET_TRIHEDRAL, STREET_RCS = np.array([140.0, -12.0, 1.0]), 100.0


def moved(mesh, shift):
    return mesh.copy().apply_translation(shift)


def street():
    """Road, wall, car, person and a trihedral far off; finer than the yard's by subdivision."""
    shift = np.array([STREET_CAR[0] - CAR_REAR[0], STREET_CAR[1] - CAR_REAR[1], 0.0])
    turn = trimesh.transformations.rotation_matrix(
        np.radians(-CAR_YAW_DEG), [0, 0, 1], [*STREET_CAR, 0]
    )
    parts = {k: moved(v, shift).apply_transform(turn) for k, v in car().items()}
    parts["car"] = parts["car"].subdivide()
    body = {
        k: moved(v, [STREET_PERSON[0] - PERSON_XY[0], STREET_PERSON[1] - PERSON_XY[1], 0])
        for k, v in person().items()
    }
    leg = (3 * (C / CARRIER_HZ) ** 2 * STREET_RCS / (4 * np.pi)) ** 0.25
    bore = (RADAR - STREET_TRIHEDRAL) / np.linalg.norm(RADAR - STREET_TRIHEDRAL)
    left = np.cross([0, 0, 1], bore)
    left /= np.linalg.norm(left)
    up = np.cross(bore, left)
    angle = np.radians([90, 210, 330])
    tips = leg * (
        bore / np.sqrt(3)
        + np.sqrt(2 / 3) * (np.cos(angle)[:, None] * left + np.sin(angle)[:, None] * up)
    )
    corner = trimesh.Trimesh(
        np.vstack([[0, 0, 0], tips]) + STREET_TRIHEDRAL,
        [[0, 1, 2], [0, 2, 3], [0, 3, 1]],
        process=False,
    )
    return {
        "ground": ground((-10.0, -80.0), 160.0, 92),
        "wall": box(*STREET_WALL),
        **parts,
        **body,
        "trihedral": corner,
    }


# ---------------------------------------------------------------- files


def write_ply(path, mesh, uv=None):
    names = "xyz" if uv is None else "xyzuv"
    data = mesh.vertices if uv is None else np.column_stack([mesh.vertices, uv])
    vertices = np.ascontiguousarray(data, "<f4")
    faces = np.zeros(len(mesh.faces), [("n", "u1"), ("i", "<i4", 3)])
    faces["n"], faces["i"] = 3, mesh.faces
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {name}" for name in names]
    header += [
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header\n",
    ]
    path.write_bytes("\n".join(header).encode() + vertices.tobytes() + faces.tobytes())


def write_png(path, image):
    """8-bit grey, no gamma chunk: the values are reflectances."""

    def chunk(kind, body):
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    height, width = image.shape
    rows = b"".join(b"\0" + row.tobytes() for row in image)
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(rows, 9))
        + chunk(b"IEND", b"")
    )


def main():
    scenes = {
        "bodies": {**body_meshes.car(), **body_meshes.person()},
        "yard": yard(),
        "table1": table1(),
        "street": street(),
        "fig3a": cylinders(0.0),
        "fig3b": cylinders(0.075, -0.075),
    }
    for scene, meshes in scenes.items():
        folder = HERE / scene if scene == "bodies" else HERE / scene / "meshes"
        folder.mkdir(parents=True, exist_ok=True)
        for name, mesh in meshes.items():
            mesh, uv = mesh if isinstance(mesh, tuple) else (mesh, None)
            write_ply(folder / f"{name}.ply", mesh, uv)
            print(f"{scene}/{name}: {len(mesh.faces)} triangles")
    textures = HERE / "yard" / "textures"
    textures.mkdir(parents=True, exist_ok=True)
    write_png(textures / "chart.png", chart_texture())


if __name__ == "__main__":
    main()
