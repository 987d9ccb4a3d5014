"""Files and folders whose bytes depend on their content alone."""
