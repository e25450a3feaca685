"""The loop in real time: grid, scheduling, shared segment, modes and limits, guardian.

An application uses `hm_driver.realtime.process.LoopProcess`; a session in lock-step uses
`hm_driver.realtime.core.LoopCore` on a `hm_driver.realtime.clock.VirtualClock`.
"""
