"""Parts of the report's page: its style, its charts, and clouds to turn."""
