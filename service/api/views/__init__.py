"""Views of the present: status, newest rows, links, hand-over."""
