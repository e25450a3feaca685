"""Measurements of the emulator for people; nothing here is a test that could fail."""
