"""The page's looks."""

STYLE = """
:root { --ink: #1d2530; --soft: #66707d; --line: #e3e7ec; --paper: #fff; --back: #f5f7f9;
  --left: #2468c9; --right: #d2542c; --mid: #4c7a51; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6eaf0; --soft: #98a2b0; --line: #313945; --paper: #1b2129; --back: #12161c;
    --left: #6ea5f5; --right: #f08a63; --mid: #86b98b; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--back); color: var(--ink); font: 15px/1.5 system-ui, "Segoe UI", Roboto, sans-serif; }
main { max-width: 1180px; margin: 0 auto; padding: 28px 20px 60px; }
h1 { font-size: 26px; margin: 0 0 14px; } h2 { font-size: 20px; margin: 0 0 12px; } h3 { font-size: 16px; margin: 28px 0 8px; }
section { background: var(--paper); border: 1px solid var(--line); border-radius: 10px; padding: 20px 22px; margin-top: 20px; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(130px, 1fr)); gap: 10px; }
.cards div { background: var(--paper); border: 1px solid var(--line); border-radius: 10px; padding: 10px 14px; }
.warning { color: #a33; font-size: 14px; }
.cards b { display: block; font-size: 17px; } .cards span, .note, .legend { color: var(--soft); font-size: 13px; }
.charts { display: grid; grid-template-columns: repeat(auto-fill, minmax(320px, 1fr)); gap: 14px; }
.chart, .strip { width: 100%; height: auto; } .strip { max-height: 230px; }
.pictures { display: flex; gap: 14px; flex-wrap: wrap; margin-top: 18px; }
.pictures img { max-width: 100%; border-radius: 8px; }
figure { margin: 0; flex: 1 1 300px; } figcaption { color: var(--soft); font-size: 13px; }
svg text { font: 10.5px system-ui, sans-serif; fill: var(--soft); }
svg .title { font-size: 13px; font-weight: 600; fill: var(--ink); }
.grid { stroke: var(--line); } .zero { stroke: var(--soft); stroke-opacity: .6; }
.line { fill: none; stroke-width: 1.6; stroke-linejoin: round; } .band { fill-opacity: .16; stroke: none; }
.mark { stroke-width: 2; }
.line.left, .mark.left, .bone.left { stroke: var(--left); } .line.right, .mark.right, .bone.right { stroke: var(--right); }
.line.mid, .bone.mid { stroke: var(--mid); } .band.left { fill: var(--left); } .band.right { fill: var(--right); }
.band.mid { fill: var(--mid); } .bone { stroke-width: 2.4; stroke-linecap: round; }
.key { display: inline-block; width: 18px; height: 4px; border-radius: 2px; vertical-align: middle; margin: 0 3px 0 10px; }
.key.left { background: var(--left); } .key.right { background: var(--right); } .key.mid { background: var(--mid); }
.raster { width: 100%; height: 170px; image-rendering: pixelated; border-radius: 6px; display: block; }
table { border-collapse: collapse; width: 100%; font-size: 13px; font-variant-numeric: tabular-nums; }
table.narrow { width: auto; } th, td { text-align: right; padding: 3px 10px; border-bottom: 1px solid var(--line); }
th:first-child { text-align: left; font-weight: 500; } tr:first-child th { color: var(--soft); font-weight: 500; }
table.narrow td { text-align: left; word-break: break-word; } table.narrow tr:first-child th { color: inherit; }
td.left { color: var(--left); } td.right { color: var(--right); } tr.bad th { color: var(--right); }
@media print { body { background: #fff; } section { break-inside: auto; } .chart { break-inside: avoid; } }
"""
