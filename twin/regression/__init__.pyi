from twin.regression.metrics import CAMERA_METRICS as CAMERA_METRICS
from twin.regression.metrics import RADAR_METRICS as RADAR_METRICS
from twin.regression.metrics import Metric as Metric
from twin.regression.statistics import Verdict as Verdict
from twin.regression.statistics import compare as compare
