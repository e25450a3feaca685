"""The loop in real time: its cycle, modes and limits, its process, and who watches over it."""
