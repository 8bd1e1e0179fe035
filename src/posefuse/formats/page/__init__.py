"""Pages: typed blocks in, one HTML file out that works offline.

A page holds headings, tables, images, plots that zoom and export, and a 3D player. Its plots are drawn in the browser by
plotly.js (basic bundle, MIT, kept compressed in `assets`); nothing is fetched. See `write_page`.
"""

from posefuse.foundation.summary import MISSING, Block, Cell, Facts, Heading, Note, Table

from .page import Cards, Details, Images, Page, Player, Side, write_page
from .plots import Band, Dots, Line, Plot, Plots, Series, Spikes, Ticks
