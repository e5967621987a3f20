"""What the cells of every page find: a folder to work in, and figures that suit the page."""

import os

import matplotlib as mpl

os.chdir(os.environ["MULTIARM_DOCS_WORKPLACE"])
mpl.rcParams.update({"figure.figsize": (7.0, 3.2), "figure.dpi": 110, "savefig.bbox": "tight"})

# An error is shown as its message: the way through the code says nothing on a page.
get_ipython().run_line_magic("xmode", "Minimal")  # noqa: F821
get_ipython().run_line_magic("colors", "nocolor")  # noqa: F821
