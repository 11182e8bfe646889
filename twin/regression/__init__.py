"""Regression tests against rendered truth, as a pytest plugin.

Installed with the package, it gives two fixtures. A test of a method on the vehicle, by name:

    def test_lmmse_on_the_yard(twin_regression):
        twin_regression.camera("yard", "workable", method="lmmse")

and of one's own, a function from a record to an image (rows, columns) in electrons:

    def test_mine_on_the_yard(twin_regression):
        twin_regression.camera("yard", "workable", method=my_reconstruction)

A radar detector is a function from a record to a list of `hardware.radar.Detection`; without one
it is the vehicle's:

    def test_detector_on_the_yard(twin_regression):
        twin_regression.radar("yard", "hybrid-79", detector=my_detector)

The scene's truth is rendered once and kept in pytest's cache. The method then runs over seeds of
the sensor's noise, and its figures are compared with a baseline: a JSON file in ``baselines/``
beside the test. Make or change one by giving the reason, which is stored with the figures before
and after:

    pytest tests/test_mine.py --update-baseline "prior measured on the new lens"

A test fails when any figure became worse by more than its metric's ``tolerance``, in the mean or at
single seeds, at a false-alarm probability of 1 % for all figures together
(`twin.regression.statistics`). Pictures before and after are then in ``regression-pictures/``.
Where records differ, of another render or version, the tolerance is wider by the model's errors
before and now (`twin.regression.model_error`).
Nothing is rounded in one's favour: a missing baseline fails, and so does one that was made with
another scene, system or number of seeds, or was edited.

``twin_truth`` gives the rendered light alone: ``twin_truth.light(scene, system)`` is what
`twin.camera.acquisition.measure` takes.
"""

from hardware.lazy import lazy_names

# The plugin is loaded by every pytest of this environment.
__getattr__, __dir__ = lazy_names(__name__)
