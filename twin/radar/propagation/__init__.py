"""Every path from the radar through the scene and back.

- `solvers`: the models by name, and who traces with which
- `physical_optics`: what meshes echo (a car, a person), by `facets`, `diffraction` and
  `surface_clutter`; `effects_by_bounds` takes edges, waves round obstacles and reflections or
  leaves them out, `edges_beside_ways` those over mirrors; `physical_optics_solver` puts all of it
  together, over `followed_images`, with mirrors and declared points as `named_paths`
- `free_space`: declared targets alone; `sionna`: paths by Sionna RT; `tabulated`: far objects from
  tables of their scattering
- `prepared_scene`, `scene`: the scene at one pose; materials, walls, images, rain and gases
- `one_way`: the path between the radar and a point, where its rays start, what walls do to it
- `result`: what all of them come to
"""
