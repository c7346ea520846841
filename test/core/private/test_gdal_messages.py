"""What GDAL says while it reads pixels."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

import pytest
import rasterio  # noqa: F401  # whose logger it is

from oaisys_core.private import gdal_messages as part
from oaisys_core.private.gdal_messages import LOGGER, gdal_messages


def test_errors_and_warnings_of_this_thread_are_collected() -> None:
    logger = logging.getLogger(LOGGER)
    with gdal_messages() as found:
        logger.info("GDAL signalled an error: err_no=%r, msg=%r", 1, "no such\nblock")
        logger.warning("%s:%s", "CPLE_AppDefined", "no end")
        logger.info("Unknown error number %r", 7)
        other = threading.Thread(target=logger.error, args=("%s:%s", "CPLE_AppDefined", "other"))
        other.start()
        other.join()
    logger.warning("%s:%s", "CPLE_AppDefined", "later")
    assert (found.errors, found.warnings) == (["no such block"], ["no end"])


def test_nothing_more_is_logged_than_before(caplog: pytest.LogCaptureFixture) -> None:
    with gdal_messages():
        logging.getLogger(LOGGER).info("GDAL signalled an error: err_no=%r, msg=%r", 1, "no")
        logging.getLogger(LOGGER).warning("%s:%s", "CPLE_AppDefined", "no end")
    assert [record.levelname for record in caplog.records] == ["WARNING"]


def test_without_that_logger_one_line_says_what_is_lost(
    monkeypatch: pytest.MonkeyPatch, fallback_lines: Callable[[], list[str]]
) -> None:
    monkeypatch.setattr(part, "LOGGER", "rasterio.no_such_module")
    part._watch_logger.cache_clear()
    for _ in range(2):
        with gdal_messages() as found:
            pass
    part._watch_logger.cache_clear()
    assert found.errors == []
    assert len(fallback_lines()) == 1
