"""The service around the loop: publishing, recording and permissions."""
