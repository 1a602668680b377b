"""Extreme cases of every public function, each against an oracle."""
