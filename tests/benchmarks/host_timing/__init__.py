"""The timing of one host: the daemon compared with cyclictest, a bare loop and bare zenoh."""
