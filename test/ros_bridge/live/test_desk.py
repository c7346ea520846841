"""What a page asks for reaches the session in order, and nothing of it is lost."""

from __future__ import annotations

import threading

import numpy as np
from waiting import PATIENCE_S

from oaisys_core.types import ModuleMetadata
from oaisys_ros_bridge.live.desk import MAX_REQUESTS, BrowserView, Desk, Request


def test_steps_add_up_and_the_newest_orientation_counts():
    desk = Desk()
    turned = np.diag((1.0, -1.0, -1.0))
    desk.post_view(BrowserView(np.array((1.0, 0.0, 0.0)), np.eye(3)))
    desk.post_view(BrowserView(np.array((0.0, 2.0, 0.0)), turned))
    view = desk.take_view()
    assert view is not None
    np.testing.assert_array_equal(view.step_m, (1.0, 2.0, 0.0))
    np.testing.assert_array_equal(view.R_map_camera, turned)
    assert desk.take_view() is None


def test_changes_of_the_light_are_joined_by_field():
    desk = Desk()
    desk.post_change(ModuleMetadata(environment={"sun_elevation_deg": 10.0}))
    desk.post_change(ModuleMetadata(environment={"haze": None}, render={"exposure_ev": 1.0}))
    desk.post_change(ModuleMetadata(environment={"sun_elevation_deg": 20.0}))
    change = desk.take_change()
    assert change is not None
    assert change.environment == {"sun_elevation_deg": 20.0, "haze": None}
    assert change.render == {"exposure_ev": 1.0}
    assert not desk.has_news()


def test_requests_come_in_order_and_too_many_are_refused():
    desk = Desk()
    assert all(desk.post(Request("new_world", {"seed": n})) for n in range(MAX_REQUESTS))
    assert not desk.post(Request("take_picture"))
    taken = [desk.take_request() for _ in range(MAX_REQUESTS)]
    assert [each.values["seed"] for each in taken if each] == list(range(MAX_REQUESTS))
    assert desk.take_request() is None


def test_who_waits_is_woken_by_news():
    desk = Desk()
    thread = threading.Thread(target=desk.wait, args=(PATIENCE_S,))
    thread.start()
    desk.post(Request("take_picture"))
    thread.join(PATIENCE_S / 2)
    assert not thread.is_alive()


def test_a_new_driver_begins_without_what_the_one_before_asked_for():
    desk, flight = Desk(), Request("choose_vehicle", {"is_rover": False})
    for seed in range(3):
        desk.post(Request("new_world", {"seed": seed}))
    desk.post_view(BrowserView(np.array((1.0, 0.0, 0.0)), np.eye(3)))
    assert desk.begin_anew(flight) == 3
    assert desk.take_request() == flight
    assert desk.take_request() is None
    assert desk.take_view() is None
    desk.post(flight)
    assert desk.begin_anew(flight) == 0
