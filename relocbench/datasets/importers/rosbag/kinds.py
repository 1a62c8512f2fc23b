"""Types of messages: what each can be used for, and which cannot be read."""

from __future__ import annotations

CLOUD = "sensor_msgs/msg/PointCloud2"
LASER = "sensor_msgs/msg/LaserScan"
PACKETS = "velodyne_msgs/msg/VelodyneScan"
IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseStamped"
POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
FIX = "sensor_msgs/msg/NavSatFix"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
OLD_TRANSFORMS = "tf/msg/tfMessage"

LIDARS = (CLOUD, PACKETS, LASER)
CAMERAS = (IMAGE, COMPRESSED)
POSES = (ODOMETRY, POSE, POSE_COVARIANCE, TRANSFORM)
ALL_TRANSFORMS = (TRANSFORMS, OLD_TRANSFORMS)
READ = (*LIDARS, *CAMERAS, CAMERA_INFO, *POSES, FIX, *ALL_TRANSFORMS)
"""the types that are decoded"""

_PACKETS = "packets of the sensor are not decoded"
UNREADABLE: dict[str, str] = {
    "livox_ros_driver/msg/CustomMsg": "convert it to PointCloud2 with times (xfer_format 0 of livox_ros_driver)",
    "livox_ros_driver2/msg/CustomMsg": "convert it to PointCloud2 with times (xfer_format 0 of livox_ros_driver2)",
    "livox_interfaces/msg/CustomMsg": "convert it to PointCloud2 with times (xfer_format 0 of the driver)",
    "ouster_ros/msg/PacketMsg": f"{_PACKETS}; play it through ouster_ros and record its PointCloud2",
    "ouster_sensor_msgs/msg/PacketMsg": f"{_PACKETS}; play it through ouster_ros and record its PointCloud2",
    "hesai_ros_driver/msg/UdpFrame": f"{_PACKETS}; play it through hesai_ros_driver and record its PointCloud2",
    "pandar_msgs/msg/PandarScan": f"{_PACKETS}; play it through the driver of Hesai and record its PointCloud2",
    "rslidar_msg/msg/RslidarPacket": f"{_PACKETS}; play it through rslidar_sdk and record its PointCloud2",
    "sensor_msgs/msg/PointCloud": "convert it to PointCloud2 (node point_cloud_converter)",
    "sensor_msgs/msg/MultiEchoLaserScan": "record the LaserScan of the driver's first echo",
    "theora_image_transport/msg/Packet": "video is not decoded; republish it as Image (image_transport republish)",
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": "video is not decoded; republish it as Image",
    "foxglove_msgs/msg/CompressedVideo": "video is not decoded; republish it as Image",
}
"""type -> what to do instead"""


def short(message_type: str) -> str:
    """A type as people write it: ``sensor_msgs/Image``."""
    return message_type.replace("/msg/", "/")
