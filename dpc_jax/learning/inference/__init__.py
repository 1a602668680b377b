"""What a trained network says of views, and how wrong that is."""
