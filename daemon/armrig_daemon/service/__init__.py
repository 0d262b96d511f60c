"""What stands around the loop: publishing, recording, who may command."""
