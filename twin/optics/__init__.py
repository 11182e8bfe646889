"""Light: the sun in the band, closed forms, air, and transport through the scene.

- `solar_irradiance`: the sun in the filter's band; `spectra`: the emitter's line behind the filter;
  `passband`: both by field angle
- `radiometry`: lens and pupil; the power of a wall's light in closed form
- `weather`: extinction by fog, rain, snow and smoke; `scattering`, `backscatter`: what air scatters
- `problem`, `tracer`, `paths`, `steps`: what is traced, and the one path tracer; `scattering` and
  `paths.ray_from` say where its rays start
- `transport`, `matrix`, `time_of_flight`, `by_object`: what is summed up of its paths
- `devices`, `emission`: lobe and vignetting of emitter and detector, light of each pattern
- `reference`: every pattern rendered by itself, by brute force
- `eye_safety`: exposure limits of the eye
"""
