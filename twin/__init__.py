"""The digital twin: what the sensors of the vehicle would send, from a scene and a system.

`run` does the whole job. The same in steps, from a scene to a scored image, and to detections:

>>> import hardware, twin
>>> scene = twin.load_scene("yard")
>>> system = twin.load_system("workable").with_({"acquisition.n_patterns": 1024})
>>> capture = twin.capture(scene, system, seed=1, fidelity=twin.PRESETS["draft"])
>>> image = hardware.reconstruct(capture.record, "lmmse")
>>> evaluation = twin.evaluate(system, capture, [image])

>>> declared = twin.Fidelity(radar="targets")  # the fastest description of a scene
>>> radar = twin.load_radar("hybrid-79")
>>> record = twin.radar_capture(scene, radar, seed=1, fidelity=declared).record
>>> detections = hardware.process(record).detections

``__init__.pyi`` says what can be had from here.
"""

from hardware.lazy import lazy_names

__version__ = "0.1.0"
__getattr__, __dir__ = lazy_names(__name__)
