"""The page: tables beside the paper's, figures, targets; as HTML and Markdown."""
