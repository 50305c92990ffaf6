"""What visitors of the viewer have set, which stays when they begin anew with another task or policy."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Settings:
    """The state of the controls that are about the page, not about the task."""

    seed: int = 0
    """taken by a reset"""
    paused: bool = False
    """whether time stands still"""
    speed: float = 1.0
    """of real time"""
    push: float = 0.5
    """velocity of a push, m/s"""
    follow: bool = True
    """whether the camera goes with the first robot"""
    field_of_view: float = 50.0
    """of the camera, from top to bottom, degrees"""
    ghost: bool = True
    """whether the reference is shown as a robot,"""
    plan: bool = True
    """the oracle's plan as a line,"""
    bound: bool = True
    """the permissible states,"""
    contacts: bool = False
    """where the robot touches the ground, and the forces there,"""
    collision: bool = False
    """and what of the robot can touch something"""
    policy: str = ""
    """which policy of the run plays; empty: there is no choice"""
    newest: bool = False
    """whether each new checkpoint of a training takes its place"""
