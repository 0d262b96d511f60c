"""The wire protocol of armrig: frames, messages and their decoder, in pure Python."""
