(async () => {
  const data = await pageData;
  const arrays = data.arrays;
  for (const one of data.plots.flatMap(plot => plot.series)) if ("width" in one) {
    // bands come as their lower edge and width
    const width = arrays[one.width];
    one.high = arrays.push(arrays[one.low].map((low, i) => low === null || width[i] === null ? null : Number((low + width[i]).toPrecision(12)))) - 1;
  }
  const code = document.createElement("script");
  code.textContent = await inflated("page-plotly");
  document.head.append(code);

  // plotly reads tags in texts; names are to be shown as they are
  const plain = text => String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
  const fileName = text => text.replace(/[^\p{L}\p{N}]+/gu, "_").replace(/^_+|_+$/g, "") || "plot";

  const polygons = (x, low, high) => {
    const outX = [], outY = [];
    for (let i = 0; i < x.length; i++) {
      if (x[i] === null || low[i] === null || high[i] === null) continue;
      let end = i;
      while (end < x.length && x[end] !== null && low[end] !== null && high[end] !== null) end++;
      if (outX.length) { outX.push(null); outY.push(null); }
      outX.push(...x.slice(i, end), ...x.slice(i, end).reverse(), x[i]);
      outY.push(...high.slice(i, end), ...low.slice(i, end).reverse(), high[i]);
      i = end;
    }
    return [outX, outY];
  };

  const traces = one => {
    const ink = one.colour && colour(one.colour), x = arrays[one.x], name = plain(one.name ?? "");
    const shared = { type: "scatter", name, legendgroup: name, showlegend: Boolean(name) };
    if (one.faint)
      return [{ ...shared, showlegend: false, mode: "lines", x, y: arrays[one.y], line: { color: faded(ink, 0.28), width: 0.8 }, hoverinfo: "skip" }];
    if (one.type === "line")
      return [{ ...shared, mode: "lines", x, y: arrays[one.y], line: { color: ink, width: 1.8 } }];
    if (one.type === "band") {
      const [bx, by] = polygons(x, arrays[one.low], arrays[one.high]);
      return [{ ...shared, showlegend: false, mode: "lines", x: bx, y: by, fill: "toself", fillcolor: faded(ink, 0.17), line: { width: 0 }, hoverinfo: "skip" }];
    }
    if (one.type === "dots")
      return [{ ...shared, mode: one.labels ? "markers+text" : "markers", x, y: arrays[one.y], marker: { color: ink, size: one.labels ? 9 : 4 },
                text: (one.labels ?? []).map(plain), textposition: "top center", cliponaxis: false }];
    if (one.type === "spikes") {
      const low = arrays[one.low], high = arrays[one.high];
      return [{ ...shared, mode: "lines", x: x.flatMap(v => [v, v, null]), y: low.flatMap((v, i) => [v, high[i], null]), line: { color: ink, width: 2.5 } }];
    }
    if (one.type === "ticks")
      return [{ ...shared, mode: "markers", x, y: x.map(() => 0), yaxis: "y2", cliponaxis: false,
                marker: { symbol: "line-ns-open", size: 9, color: ink, line: { width: 2 } } }];
  };

  const layout = (plot, paper) => {
    const ink = colour("ink"), soft = colour("soft"), grid = colour("line");
    const named = plot.legend ? 22 : 0;
    const axis = (title, range) => ({
      title: { text: plain(title), font: { size: 11, color: soft }, standoff: 6 }, gridcolor: grid, zerolinecolor: grid, linecolor: grid,
      tickfont: { size: 11, color: soft }, automargin: true, exponentformat: "power", ...(range && { range }),
    });
    return {
      height: named + (plot.equal ? 380 : paper ? 200 : 260),
      margin: { l: 46, r: 14, t: (paper ? 8 : 30) + named, b: 40 },
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: ink, size: 11, family: "system-ui, sans-serif" },
      showlegend: named > 0, legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom", font: { size: 11 }, traceorder: "normal" },
      hovermode: plot.equal ? "closest" : "x unified", hoverlabel: { bgcolor: colour("paper"), font: { size: 11, color: ink } },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: soft, activecolor: ink },
      dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom",
      xaxis: axis(plot.x, plot.ranges[0]),
      yaxis: { ...axis(plot.y, plot.ranges[1]), ...(plot.equal && { scaleanchor: "x" }) },
      ...(plot.series.some(one => one.type === "ticks") && { yaxis2: { overlaying: "y", range: [0, 1], visible: false, fixedrange: true } }),
    };
  };

  const csvOf = plot => {
    const quoted = text => `"${String(text).replace(/"/g, '""')}"`, columns = [];
    let drawnOver = null;
    for (const one of plot.series) {
      if (one.type === "ticks") { columns.push([`${one.name}, ${plot.x}`, arrays[one.x]]); continue; }
      if (one.x !== drawnOver) columns.push([plot.x, arrays[one.x]]);
      drawnOver = one.x;
      for (const part of ["y", "low", "high"])
        if (part in one) columns.push([part === "y" ? one.name : `${one.name} ${part}`, arrays[one[part]]]);
      if (one.labels) columns.push([`${one.name} label`, one.labels]);
    }
    const cell = value => value === undefined || value === null ? "" : typeof value === "number" ? value : quoted(value);
    const rows = Array.from({ length: Math.max(0, ...columns.map(([, values]) => values.length)) }, (_, i) => columns.map(([, values]) => cell(values[i])));
    return [columns.map(([name]) => quoted(name)), ...rows].map(row => row.join(",")).join("\n") + "\n";
  };

  const saveCsv = plot => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([csvOf(plot)], { type: "text/csv" }));
    link.download = fileName(plot.title) + ".csv";
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
  };

  // the buttons are named one by one, so that none comes that sends data to a server
  const saveImage = (plot, format) => ({
    name: `Save as ${format.toUpperCase()}`, icon: Plotly.Icons[format === "png" ? "camera" : "pencil"],
    click: shown => Plotly.downloadImage(shown, { format, filename: fileName(plot.title), width: shown.clientWidth, height: shown.clientHeight, scale: 2 }),
  });
  const config = plot => ({
    responsive: true, displaylogo: false, plotlyServerURL: "",
    modeBarButtons: [
      ["zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"],
      [saveImage(plot, "png"), saveImage(plot, "svg"), { name: "Save the data as CSV", icon: Plotly.Icons.disk, click: () => saveCsv(plot) }],
    ],
  });

  const onPaper = matchMedia("print");
  const figures = [...document.querySelectorAll(".plot")];
  const resized = new ResizeObserver(seen => seen.forEach(one => { if (!onPaper.matches && one.contentRect.width) Plotly.Plots.resize(one.target); }));
  const draw = (figure, paper) => {
    const plot = data.plots[figures.indexOf(figure)], axes = figure.querySelector(".axes");
    if (!figure.classList.contains("drawn")) resized.observe(axes);
    figure.classList.add("drawn");
    return Plotly.react(axes, plot.series.flatMap(traces), layout(plot, paper), config(plot));
  };
  const soon = new IntersectionObserver(seen => {
    for (const one of seen) if (one.isIntersecting) { soon.unobserve(one.target); draw(one.target); }
  }, { rootMargin: "600px" });
  figures.forEach(figure => soon.observe(figure));
  dark.addEventListener("change", () => figures.filter(figure => figure.classList.contains("drawn")).forEach(figure => draw(figure)));

  // on paper every plot is there, as wide as a column of an A4 page, in the colours of print
  const printed = () => figures.forEach(figure => {
    draw(figure, true);
    Plotly.relayout(figure.querySelector(".axes"), { width: 322, autosize: false });
  });
  const onScreen = () => figures.forEach(figure => { draw(figure); Plotly.relayout(figure.querySelector(".axes"), { width: null, autosize: true }); });
  addEventListener("beforeprint", printed);
  onPaper.addEventListener("change", event => event.matches ? printed() : onScreen());
})();
