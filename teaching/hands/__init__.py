"""Hands: whoever holds the end effector, a person or a simulated demonstrator."""
