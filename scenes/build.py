"""Write the meshes and the chart texture of the scenes kept in this folder.

    python scenes/build.py

Axes follow REP 103 (x forward, y left, z up), in metres, in scene coordinates:
the rig stands at (0, 0, 1.2) and looks along +x over a square field of 20 deg.
Meshes are binary PLY with float32 vertices; every closed body is watertight with
outward normals, and so is the car but for its underside at the wheels. The folder
`bodies` holds car and person alone, in their own frames (`body_meshes.py`). The XML
and TOML files beside the meshes are written by hand.
"""

import struct
import zlib
from pathlib import Path

import numpy as np
import trimesh
from body_meshes import AXLES, box, car, join, limb, loft, person, wheel

HERE = Path(__file__).resolve().parent

C = 299_792_458.0
CARRIER_HZ = 79e9
RIG = np.array([0.0, 0.0, 1.2])
RADAR = RIG + [0.0, 0.0, -0.3]

# Yard: where things stand. scene.toml repeats the positions a radar should find.
WALL_X, WALL_SIZE = 12.3, (0.25, 10.0, 3.0)
CAR_REAR, CAR_YAW_DEG = (8.2, 0.1), 17.0
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


def quad(corners):
    """Two triangles; the normal points to where the corners run anticlockwise."""
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def cylinder(xy, radius, z0, z1, around=48):
    phi = np.linspace(0, 2 * np.pi, around, endpoint=False)
    circle = np.stack([xy[0] + radius * np.cos(phi), xy[1] + radius * np.sin(phi), 0 * phi], -1)
    return loft(np.stack([circle + [0, 0, z] for z in np.linspace(z0, z1, 5)]))


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


def placed(parts, xy, yaw_deg=0.0):
    """Copies of a body's parts, turned about z and moved to xy."""
    to_scene = trimesh.transformations.rotation_matrix(np.radians(yaw_deg), [0, 0, 1])
    to_scene[:2, 3] = xy
    return {name: mesh.copy().apply_transform(to_scene) for name, mesh in parts.items()}


def trihedral(apex=TRIHEDRAL_APEX):
    """Triangular trihedral of the wanted boresight RCS, opening towards the radar.

    The inner faces are three right isosceles triangles of leg a. The back is one apex
    4 mm behind, so the edges are sharp and no rim adds to the return.
    """
    wavelength = C / CARRIER_HZ
    leg = (3 * wavelength**2 * TRIHEDRAL_RCS / (4 * np.pi)) ** 0.25
    bore = (RADAR - apex) / np.linalg.norm(RADAR - apex)
    left = np.cross([0, 0, 1], bore)
    left /= np.linalg.norm(left)
    up = np.cross(bore, left)
    turn = np.radians([90, 210, 330])
    tips = leg * (
        bore / np.sqrt(3)
        + np.sqrt(2 / 3) * (np.cos(turn)[:, None] * left + np.sin(turn)[:, None] * up)
    )
    vertices = np.vstack([[0, 0, 0], tips, -0.004 * bore]) + apex
    faces = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [4, 2, 1], [4, 3, 2], [4, 1, 3]]
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if mesh.volume < 0:
        mesh.invert()
    foot = apex + 0.004 * bore
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
        **placed(car(), CAR_REAR, CAR_YAW_DEG),
        **placed(person(), PERSON_XY),
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


def street():
    """Road, wall, car, person and a trihedral far off."""
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
        **placed(car(), STREET_CAR),
        **placed(person(), STREET_PERSON),
        "trihedral": corner,
    }


# ---------------------------------------------------------------- crossing

# Everything comes round after 60 s: the rig ten times in ten minutes.
LAP_S, LAP_STEP_S = 60.0, 0.25
RIG_SPEED, RIG_STRAIGHT, RIG_TURN = 5.0, 70.0, 80.0  # m/s; m of one straight and one bend
RIG_START = (20.0, (0.0, 0.0), 0.0)  # m along the first straight; x, y there; heading in deg
CAR_SPEED, CAR_STRAIGHT, CAR_TURN = 1.4, 14.0, 28.0
CAR_START = (6.5, (12.0, 0.1), 90.0)  # of the rear axle
WALK_SPEED, WALK_STRAIGHT, WALK_TURN, WALK_S = 1.3, 7.0, 6.0, 20.0
WALK_START = (1.0, (7.3, -1.1), 0.0)
HIP, SHOULDER, KNEE, ELBOW = 0.88, 1.39, 0.50, 1.12  # heights of the joints
CROSSING_WALLS = {"wall_left": (1.3, 6.5), "wall_right": (-7.0, -1.3)}
CROSSING_POSTS = {"post_near": (9.0, 1.25), "post_gate": (16.6, 1.15), "post_far": (30.0, -1.6)}
CROSSING_APEX = np.array([8.6, 0.75, 1.0])


def course(start, speed, straight, turn, lap_s, side):
    """Closed way of two straights and two bends whose curvature comes and goes as a raised cosine,
    at constant speed: times, x, y, yaw in deg. ``side``: 1 turns left, -1 right.
    """
    begun, place, heading_deg = start
    half = straight + turn
    assert abs(2 * half - speed * lap_s) < 1e-9

    def heading(s):
        turns, along = np.divmod(s, half)
        u = np.clip((along - straight) / turn, 0, 1)
        return np.pi * side * (turns + u - np.sin(2 * np.pi * u) / (2 * np.pi))

    times = np.arange(round(lap_s / LAP_STEP_S) + 1) * LAP_STEP_S
    s = begun + speed * times
    nodes, weights = np.polynomial.legendre.leggauss(16)
    step = np.diff(s)[:, None] / 2
    fine = heading((s[1:] + s[:-1])[:, None] / 2 + step * nodes)
    ways = np.stack([(step * weights * f(fine)).sum(axis=1) for f in (np.cos, np.sin)], axis=1)
    xy = np.vstack([[0, 0], np.cumsum(ways, axis=0)])
    xy[-1] = xy[0]  # to rounding already
    to_world = np.radians(heading_deg) - heading(begun)
    c, s_ = np.cos(to_world), np.sin(to_world)
    x, y = (xy @ np.array([[c, s_], [-s_, c]]) + place).T
    yaw = np.degrees(heading(s) + to_world)
    return np.stack([times, x, y, 0 * x, yaw], axis=1)


def crossing_courses():
    """Ways of the frames of the rig, the car (rear axle, on the ground) and the person."""
    rig = course(RIG_START, RIG_SPEED, RIG_STRAIGHT, RIG_TURN, LAP_S, 1)
    rig[:, 3] = RIG[2]
    return {
        "rig": rig,
        "car": course(CAR_START, CAR_SPEED, CAR_STRAIGHT, CAR_TURN, LAP_S, 1),
        "person": course(WALK_START, WALK_SPEED, WALK_STRAIGHT, WALK_TURN, WALK_S, -1),
    }


def crossing_car():
    """Body from the middle of the rear axle on the ground; tyre and rim about their own axle."""
    body = {name: mesh.copy() for name, mesh in car().items()}
    for mesh in body.values():
        mesh.apply_translation([-AXLES[0], 0, 0])
    tyre, rim = wheel()
    return {
        **{name: body[name] for name in ("car", "car_windows", "car_plate")},
        "tyre": tyre,
        "rim": rim,
    }


def walker():
    """A person in parts that faces x, its limbs hanging straight, each where it stands."""
    about = trimesh.transformations.rotation_matrix(np.pi, [0, 0, 1])
    torso = limb(
        [(0, 0, 0.86), (0, 0, 0.95), (0, 0, 1.10), (0, 0, 1.25), (-0.01, 0, 1.38), (0, 0, 1.45)],
        [0.145, 0.165, 0.150, 0.170, 0.175, 0.110],
        flat=(0.66, 1.0),
        around=50,
        fold=(0.004, 0.22),
    ).apply_transform(about)
    neck = limb([(0, 0, 1.43), (0.005, 0, 1.56)], [0.055, 0.052], around=32)
    head = trimesh.creation.icosphere(subdivisions=3).apply_scale([0.098, 0.076, 0.118])
    parts = {"person": torso, "head": join(neck, head.apply_translation([0.01, 0, 1.632]))}
    for side, s in (("left", 1), ("right", -1)):
        foot = trimesh.creation.icosphere(subdivisions=2).apply_scale([0.135, 0.05, 0.05])
        parts |= {
            f"thigh_{side}": limb(
                [(0, s * 0.095, HIP), (0, s * 0.095, 0.7), (0, s * 0.095, KNEE)],
                [0.088, 0.076, 0.064],
                around=36,
                fold=(0.004, 0.32),
                phase=1.0 + s,
            ),
            f"shin_{side}": join(
                limb(
                    [(0, s * 0.095, KNEE), (0, s * 0.095, 0.3), (0, s * 0.095, 0.12)],
                    [0.064, 0.060, 0.055],
                    around=36,
                    fold=(0.003, 0.27),
                    phase=0.5 + s,
                ),
                foot.apply_translation([0.05, s * 0.10, 0.05]),
            ),
            f"arm_{side}": limb(
                [(0, s * 0.195, SHOULDER), (0, s * 0.21, 1.25), (0, s * 0.215, ELBOW)],
                [0.058, 0.052, 0.047],
                around=28,
                fold=(0.003, 0.27),
                phase=2.0 - s,
            ),
            f"forearm_{side}": limb(
                [(0, s * 0.215, ELBOW), (0, s * 0.215, 0.87), (0, s * 0.215, 0.76)],
                [0.047, 0.036, 0.034],
                around=28,
            ),
        }
    return parts


def crossing():
    """Ground, walls, posts and a trihedral in the scene; car and person in their own frames."""
    posts = {name: cylinder(xy, 0.04, 0, 1.1) for name, xy in CROSSING_POSTS.items()}
    walls = {
        name: box([17.0, low, 0], [17.25, high, 2.5])
        for name, (low, high) in CROSSING_WALLS.items()
    }
    return {
        "ground": ground((-60.0, -50.0), 160.0, 32),
        **walls,
        "wall_back": box([11.75, 32.4, 0], [12.0, 38.4, 2.5]),  # of the way back
        **posts,
        **trihedral(CROSSING_APEX),
        **crossing_car(),
        **walker(),
    }


def write_course(path, rows):
    lines = ["time_s,x_m,y_m,z_m,yaw_deg"]
    lines += [",".join(f"{value:.9f}".rstrip("0").rstrip(".") for value in row) for row in rows]
    path.write_text("\n".join(lines) + "\n")


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
        "bodies": {**car(), **person()},
        "yard": yard(),
        "table1": table1(),
        "street": street(),
        "fig3a": cylinders(0.0),
        "fig3b": cylinders(0.075, -0.075),
        "crossing": crossing(),
    }
    for scene, meshes in scenes.items():
        folder = HERE / scene if scene == "bodies" else HERE / scene / "meshes"
        folder.mkdir(parents=True, exist_ok=True)
        for name, mesh in meshes.items():
            mesh, uv = mesh if isinstance(mesh, tuple) else (mesh, None)
            write_ply(folder / f"{name}.ply", mesh, uv)
            print(f"{scene}/{name}: {len(mesh.faces)} triangles")
    for name, rows in crossing_courses().items():
        write_course(HERE / "crossing" / f"{name}.csv", rows)
    textures = HERE / "yard" / "textures"
    textures.mkdir(parents=True, exist_ok=True)
    write_png(textures / "chart.png", chart_texture())


if __name__ == "__main__":
    main()
