"""From somebody's model of a robot to its ``robot.yaml``."""
