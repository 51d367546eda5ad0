"""Console of the operators: static pages, read by a browser, that use the REST interface alone."""
