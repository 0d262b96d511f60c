"""What the daemon and its clients share: samples, telemetry, calibration, the arm."""
