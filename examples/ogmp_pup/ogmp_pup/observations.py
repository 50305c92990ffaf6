"""An observation of our own."""

import numpy as np

from ogmp_sb3.extend import EnvView, Part, Signal, observation, quat_rotate_inverse

DOWN = np.array([0.0, 0.0, -1.0])


@observation
def gravity_direction(view: EnvView) -> Signal:
    """Where down is, as the trunk feels it: a unit vector in the body frame (3)."""
    return Signal(quat_rotate_inverse(view.base_quat, DOWN), np.full(3, 0.3), (Part("gravity_direction", "1", 3),))
