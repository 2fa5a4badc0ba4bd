"""Rigid bodies with joints, and the robot files that describe them."""
