"""A mode of our own."""

from ogmp_sb3.extend import GRAVITY, Contact, Plateau, Segment, Span, mode

BAR = 0.04  # m: length of a bar along the track
FLIGHT = 0.40  # m along the track: pup's wheelbase of 0.30 m and the bar, with 3 cm to spare before and behind
CROUCH = 0.12  # m: stance before the flight
LANDING = 0.40  # m: flat ground behind a bar


@mode
def hurdle(h: float, v: float = 1.2, run_up: float = 0.6) -> Segment:
    """Hop over a bar that lies across the track, all feet in the air from before it to behind it.

    :param h: height of the bar, m
    :param v: heading speed, m/s
    :param run_up: flat ground before the bar, m
    """
    take_off = run_up + 0.5 * (BAR - FLIGHT)
    end = run_up + BAR + LANDING
    ahead = (v, 0.0)
    return Segment(
        length=end,
        plateaus=(Plateau(0.0, end, 0.0), Plateau(run_up, run_up + BAR, h)),
        spans=(
            Span(end=take_off - CROUCH, velocity=ahead),
            Span(end=take_off, velocity=ahead, contact=Contact.STANCE),
            Span(end=take_off + FLIGHT, velocity=ahead, contact=Contact.FLIGHT, apex=GRAVITY * (FLIGHT / v) ** 2 / 8),
            Span(end=end, velocity=ahead),
        ),
    )
