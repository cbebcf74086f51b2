"""Schemas of the messages in a log, as ROS 2 message definitions ("ros2msg" in MCAP's registry).

A schema is the message's own definition followed by those of every message it contains, each under a line of
equals signs and `MSG: package/Name`. Source: MCAP's registry of well-known encodings, and the definitions of
ROS 2's `common_interfaces`, `geometry2` and `rcl_interfaces`.
"""

from collections.abc import Sequence

_TIME = "int32 sec\nuint32 nanosec\n"
_HEADER = "builtin_interfaces/Time stamp\nstring frame_id\n"
_JOINT_STATE = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
_TRANSFORM_STAMPED = "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
_TRANSFORM = "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"
_VECTOR3 = "float64 x\nfloat64 y\nfloat64 z\n"
_QUATERNION = "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
_LOG = (
    "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\n"
    "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\n"
    "uint32 line\n"
)


def _with_parts(definition: str, **parts: str) -> bytes:
    rule = "=" * 80
    text = definition
    for name, part in parts.items():
        text += f"{rule}\nMSG: {name.replace('__', '/')}\n{part}"
    return text.encode()


JOINT_STATE = (
    "sensor_msgs/msg/JointState",
    _with_parts(_JOINT_STATE, std_msgs__Header=_HEADER, builtin_interfaces__Time=_TIME),
)
TF_MESSAGE = (
    "tf2_msgs/msg/TFMessage",
    _with_parts(
        "geometry_msgs/TransformStamped[] transforms\n",
        geometry_msgs__TransformStamped=_TRANSFORM_STAMPED,
        std_msgs__Header=_HEADER,
        builtin_interfaces__Time=_TIME,
        geometry_msgs__Transform=_TRANSFORM,
        geometry_msgs__Vector3=_VECTOR3,
        geometry_msgs__Quaternion=_QUATERNION,
    ),
)
STRING = ("std_msgs/msg/String", b"string data\n")
LOG = ("rcl_interfaces/msg/Log", _with_parts(_LOG, builtin_interfaces__Time=_TIME))
CONTROL_NAME = "dpcontrol_msgs/msg/Control"


def control_schema(fields: Sequence[str]) -> tuple[str, bytes]:
    """Return name and definition of the control message: one float64 for each name in `fields`."""
    return CONTROL_NAME, "".join(f"float64 {field}\n" for field in fields).encode()
