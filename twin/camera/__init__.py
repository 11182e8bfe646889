"""The camera twin: what a single-pixel camera would measure of the scene, and how good it is."""

from twin.camera.acquisition import Capture, capture
from twin.camera.evaluation import Evaluation, evaluate

__all__ = ["Capture", "Evaluation", "capture", "evaluate"]
