"""A node's parameters: declared from its table, checked in one place, read as typed values."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.parameter import Parameter

from oaisys_core.errors import InvalidInputError, did_you_mean, one_of, quote
from oaisys_ros_bridge.guarded_node import GuardedNode
from oaisys_ros_bridge.parameters.table import Changeable, ParameterRow, ParameterTable
from oaisys_ros_bridge.private.parameters_at_start import parameters_at_start

LARGEST_INTEGER = 2**63 - 1
QOS_PREFIX = "qos_overrides."
"""Of parameters that rclpy declares with a publisher or subscription."""
PARAMETER_TYPES = {
    bool: Parameter.Type.BOOL,
    int: Parameter.Type.INTEGER,
    float: Parameter.Type.DOUBLE,
    str: Parameter.Type.STRING,
    list: Parameter.Type.STRING_ARRAY,
}


def descriptor_of(row: ParameterRow) -> ParameterDescriptor:
    """Return what ``ros2 param describe`` shows of a parameter."""
    descriptor = ParameterDescriptor(
        name=row.name,
        type=PARAMETER_TYPES[row.kind].value,
        description=row.description,
        additional_constraints=f"{row.expectation}; can be set {row.changeable.value}",
        read_only=row.changeable is Changeable.AT_START,
    )
    if row.least is not None or row.most is not None:
        least, most = row.least, row.most
        if row.kind is int:
            whole = IntegerRange(
                from_value=-LARGEST_INTEGER if least is None else int(least),
                to_value=LARGEST_INTEGER if most is None else int(most),
            )
            descriptor.integer_range = [whole]
        else:
            floating = FloatingPointRange(
                from_value=-sys.float_info.max if least is None else float(least),
                to_value=sys.float_info.max if most is None else float(most),
            )
            descriptor.floating_point_range = [floating]
    return descriptor


class ParameterNode(GuardedNode):
    """Declares the parameters of a table, and accepts changes or refuses them with a reason.

    Mix it in before `Node` or `LifecycleNode`. After `declare_table`, ``parameters`` holds the
    values by name. It is replaced as a whole, so a thread that keeps it sees consistent values.
    """

    parameters: Mapping[str, Any]

    def declare_table(self, table: ParameterTable, **defaults: Any) -> Mapping[str, Any]:
        """Declare all parameters and return their values.

        Args:
            table: The parameters.
            defaults: Other defaults than the table's.

        Raises:
            InvalidInputError: The node was started with an invalid value.
        """
        values = {}
        for row in table:
            default = defaults.get(row.name, row.default)
            # Of any type at first, so that wrong values are refused by `check`, with its message.
            anything = ParameterDescriptor(dynamic_typing=True)
            started_with = self.declare_parameter(row.name, default, anything).value
            values[row.name] = row.check(started_with)
            value = Parameter(row.name, PARAMETER_TYPES[row.kind], values[row.name])
            self.set_descriptor(row.name, descriptor_of(row), value.get_parameter_value())
        table.check_together(values)
        self._table = table
        self.parameters = values
        self.add_post_set_parameters_callback(self._take)
        self._warn_of_unknown_parameters()
        return values

    def _warn_of_unknown_parameters(self) -> None:
        """Name what the node was started with and does not have: rclpy drops it.

        It is no error, because a file of parameters may be for several nodes.
        """
        for name in parameters_at_start(self):
            if not self.has_parameter(name) and not name.startswith(QOS_PREFIX):
                meant = did_you_mean(name, [row.name for row in self._table])
                self.get_logger().warning(f"parameter {quote(name)} is unknown here{meant}")

    def reason_against(self, row: ParameterRow) -> str:
        """Return why a parameter cannot be set now, or nothing."""
        if row.changeable is Changeable.AT_START:
            return "no change: it is read when the node starts"
        return ""

    def on_parameters(self, changed: Mapping[str, Any]) -> None:
        """Apply new values; ``parameters`` has them already."""

    def set_parameters(self, parameter_list: list[Parameter]) -> list[SetParametersResult]:
        """Set parameters one by one."""
        return [self.set_parameters_atomically([parameter]) for parameter in parameter_list]

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set all of them, or none and say why."""
        try:
            checked = [self._check(parameter) for parameter in parameter_list]
            changed = {parameter.name: parameter.value for parameter in checked}
            self._table.check_together({**self.parameters, **changed})
        except InvalidInputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return super().set_parameters_atomically(checked)

    def _check(self, parameter: Parameter) -> Parameter:
        if parameter.name not in self._table:
            if self.has_parameter(parameter.name):  # one of rclpy's own
                return parameter
            expected = one_of((row.name for row in self._table), parameter.name)
            raise InvalidInputError("parameter", parameter.name, expected)
        row = self._table[parameter.name]
        value = row.check(parameter.value)
        if reason := self.reason_against(row):
            raise InvalidInputError(row.name, value, reason)
        return Parameter(row.name, PARAMETER_TYPES[row.kind], value)

    def _take(self, parameters: list[Parameter]) -> None:
        changed = {p.name: p.value for p in parameters if p.name in self._table}
        if changed:
            self.parameters = {**self.parameters, **changed}
            self.on_parameters(changed)
