"""The check of a data set: its files, its records, and the images against the worlds themselves."""

from oaisys_dataset.check.checker import check_dataset
from oaisys_dataset.check.report import CheckReport, DatasetFinding

__all__ = ["CheckReport", "DatasetFinding", "check_dataset"]
