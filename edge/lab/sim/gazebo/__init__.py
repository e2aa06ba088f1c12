"""Import of Gazebo worlds (SDF) as a textured mesh and boxes: `edge worlds import`."""
