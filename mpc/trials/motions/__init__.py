"""Motions to follow: references, standard trajectories of joints and arms, their files, and learned corrections."""
