"""The stages in a row: objects in, an annotated dataset out."""
