"""Parts of the report's page: its style, tables, pictures, and clouds to turn."""
