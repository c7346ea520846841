"""Calibrations of cameras and IMUs as other programs write them."""

from oaisys_core.files.calibrations.reading import read_calibration
from oaisys_core.files.calibrations.records import CalibratedCamera, Calibration

__all__ = ["CalibratedCamera", "Calibration", "read_calibration"]
