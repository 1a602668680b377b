"""What runs training: loop, compiled programs, records, checkpoints."""
