"""The machine: angles, description, kinematics, servos, lamp, cameras."""
