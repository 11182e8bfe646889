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
from body_meshes import box, car, join, loft, person

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
