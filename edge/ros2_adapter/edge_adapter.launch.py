"""Start the adapter with the robot: `ros2 launch edge_adapter.launch.py config:=my-robot.yaml`.

It imports nothing of `edge`, and runs the command `edge`, by default the one on the path.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration


def generate_launch_description():
    """Return the launch description; called by `ros2 launch`."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("config", description="path of edge's configuration (YAML)"),
            DeclareLaunchArgument(
                "edge", default_value="edge", description="path or name of the `edge` command"
            ),
            ExecuteProcess(
                cmd=[LaunchConfiguration("edge"), "ros2-adapter", LaunchConfiguration("config")],
                name="edge_adapter",
                output="screen",
                respawn=True,
                respawn_delay=5.0,
            ),
        ]
    )
