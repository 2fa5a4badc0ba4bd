"""The logger of the package. It is silent unless the program that imports the package configures logging."""

import logging

logger = logging.getLogger("fieldbake")
logger.addHandler(logging.NullHandler())
