"""Floor 3: extreme cases of every public function, and what became of them."""
