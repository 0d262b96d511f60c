"""Modules shared by the daemon and its clients: samples, telemetry, calibration, the arm."""
