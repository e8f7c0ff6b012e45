"use strict";
(async () => {
  const content = JSON.parse(document.getElementById("content").textContent);
  const root = document.documentElement;
  const main = document.getElementById("main");
  const drawn = [];  // what is drawn again if the theme changes

  // Arrays ------------------------------------------------------------------------------------------

  const numbers = {};

  function array(name) {
    if (!(name in numbers)) {
      const { dtype, bdata, shape } = content.arrays[name];
      const bytes = Uint8Array.from(atob(bdata), (c) => c.charCodeAt(0));
      const values = dtype === "f4" ? new Float32Array(bytes.buffer) : new Float64Array(bytes.buffer);
      const width = shape.length > 1 ? shape[1] : values.length;
      numbers[name] = {
        rows: shape.length > 1 ? shape[0] : 1,
        width,
        row: (n) => values.subarray(n * width, (n + 1) * width),
      };
    }
    return numbers[name];
  }

  // Put arrays in the places of what stands for them; see "of" in page.py.
  function resolved(value) {
    if (Array.isArray(value)) return value.map(resolved);
    if (value === null || typeof value !== "object") return value;
    if (!("array" in value)) {
      return Object.fromEntries(Object.entries(value).map(([key, inner]) => [key, resolved(inner)]));
    }
    const known = array(value.array);
    if ("row" in value) {
      const row = Array.from(known.row(value.row));
      if (value.closed) row.push(row[row.length - 1]);
      return row;
    }
    return Array.from({ length: known.rows }, (_, n) => known.row(n));
  }

  // Theme -------------------------------------------------------------------------------------------

  function colour(name) {
    return getComputedStyle(root).getPropertyValue(`--${name}`).trim();
  }

  function themed(layout, height) {
    const axis = () => ({ gridcolor: colour("line"), zerolinecolor: colour("faint"), automargin: true });
    const given = resolved(layout);
    const narrow = window.innerWidth < 640;
    return {
      ...given,
      height,
      margin: { l: narrow ? 45 : 60, r: 12, t: 10, b: 40 },
      paper_bgcolor: "rgba(0,0,0,0)",
      plot_bgcolor: "rgba(0,0,0,0)",
      font: { color: colour("ink"), family: getComputedStyle(document.body).fontFamily, size: 12 },
      hoverlabel: { bgcolor: colour("card"), bordercolor: colour("line"), font: { color: colour("ink") } },
      xaxis: { ...axis(), ...given.xaxis },
      yaxis: { ...axis(), ...given.yaxis },
      legend: { orientation: "h", y: -0.18, yanchor: "top", ...given.legend },
    };
  }

  const config = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["lasso2d", "select2d"] };

  function inked(traces) {
    return traces.map(({ meta, ...trace }) =>
      meta === "ink" ? { ...trace, line: { ...trace.line, color: colour("ink") } } : trace);
  }

  // Elements ----------------------------------------------------------------------------------------

  function element(name, attributes = {}, ...children) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) {
      if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
      else if (value !== undefined && value !== false) made.setAttribute(key, value);
    }
    made.append(...children.filter((child) => child !== undefined && child !== null));
    return made;
  }

  let labels = 0;

  function chooser(label, options, change) {
    const id = `choice-${++labels}`;
    const select = element("select", { id, onchange: () => change(Number(select.value)) },
      ...options.map((option, n) => element("option", { value: n }, option)));
    return [element("label", { for: id }, label, select), select];
  }

  // Draw when it comes into view: a page of many charts opens at once.
  function whenSeen(target, draw) {
    let done = false;
    const once = () => { if (!done) { done = true; draw(); drawn.push(draw); } };
    const watcher = new IntersectionObserver((entries) => {
      if (entries.some((entry) => entry.isIntersecting)) { watcher.disconnect(); once(); }
    }, { rootMargin: "600px" });
    watcher.observe(target);
    window.addEventListener("beforeprint", once);
  }

  function shown(value) {
    if (value === null || value === undefined) return "";
    if (typeof value !== "number") return String(value);
    if (Number.isInteger(value)) return value.toLocaleString("en");
    const size = Math.abs(value);
    if (size >= 1e-3 && size < 1e9) return value.toLocaleString("en", { maximumSignificantDigits: size >= 1000 ? 9 : 5 });
    return value.toExponential(2);
  }

  // Parts -------------------------------------------------------------------------------------------

  const parts = {
    tiles: ({ tiles }) => element("dl", { class: "tiles" }, ...tiles.map(({ label, value, note }) =>
      element("div", { class: "tile" }, element("dt", {}, label),
        element("dd", {}, element("div", { class: "value" }, value), element("div", { class: "note" }, note))))),

    notes: ({ texts, mild }) => element("div", mild ? { class: "notes mild" } : { class: "notes", role: "alert" },
      ...texts.map((text) => element("p", {}, text))),

    chart: ({ title, views, layout, height, choice }) => {
      const plot = element("div", { class: "plot", style: `height:${height}px`, role: "img", "aria-label": title });
      let current = 0;
      const draw = () => {
        const view = views[current];
        Plotly.react(plot, inked(resolved(view.traces)), themed({ ...layout, ...view.layout }, height), config);
      };
      const controls = views.length > 1
        ? chooser(choice, views.map((view) => view.label), (n) => { current = n; draw(); })[0] : undefined;
      whenSeen(plot, draw);
      return element("figure", {}, element("div", { class: "bar" }, element("h3", {}, title), controls), plot);
    },

    table: ({ title, columns, rows, most }) => table(title, columns, rows, most),

    diagram,
    explorer,
  };

  function table(title, columns, rows, most) {
    const numeric = columns.map((_, n) => rows.some((row) => typeof row[n] === "number")
      && rows.every((row) => row[n] === null || row[n] === "" || typeof row[n] === "number"));
    const body = element("tbody");
    let order = rows.map((_, n) => n), sorted = null, ascending = true, all = rows.length <= most;
    const key = (value) => Array.isArray(value) ? value[0] : value;
    const fill = () => {
      body.replaceChildren(...(all ? order : order.slice(0, most)).map((n) => element("tr", {},
        ...rows[n].map((value, column) => element("td", numeric[column] ? { class: "number" } : {},
          Array.isArray(value) ? element("a", { href: value[1] }, value[0]) : shown(value))))));
    };
    const heads = columns.map((column, n) => element("th", { scope: "col", class: numeric[n] ? "number" : undefined },
      element("button", { type: "button", onclick: () => {
        ascending = sorted === n ? !ascending : true;
        sorted = n;
        order.sort((a, b) => {
          const [one, other] = [key(rows[a][n]), key(rows[b][n])];
          if (one === null || other === null) return (one === null) - (other === null);
          const sign = numeric[n] ? one - other : String(one).localeCompare(String(other), "en", { numeric: true });
          return ascending ? sign : -sign;
        });
        heads.forEach((head, m) => head.setAttribute("aria-sort", m !== n ? "none" : ascending ? "ascending" : "descending"));
        fill();
      } }, column)));
    fill();
    const made = element("div", { class: "scroll" }, element("table", {}, element("caption", {}, title),
      element("thead", {}, element("tr", {}, ...heads)), body));
    if (!all) {
      const more = element("button", { type: "button", onclick: () => { all = true; fill(); more.remove(); } },
        `Show all ${rows.length.toLocaleString("en")} rows`);
      made.append(more);
    }
    return made;
  }

  // Network -----------------------------------------------------------------------------------------

  function diagram({ title, buses, places, branches, edges, colours, moments }) {
    const height = Math.min(620, Math.max(360, window.innerWidth * 0.6));
    const plot = element("div", { class: "plot", style: `height:${height}px`, role: "img", "aria-label": title });
    const names = Object.keys(colours);
    const scale = "Viridis";
    let label = names[0], moment = 0, timer = null;
    const many = buses.length > 60;
    const size = Math.max(5, Math.min(18, 260 / Math.sqrt(buses.length)));

    const output = element("output", { "aria-live": "polite" });
    const slider = element("input", { type: "range", min: 0, max: moments.length - 1, value: 0, "aria-label": "moment",
      oninput: () => { moment = Number(slider.value); draw(); } });
    const play = element("button", { type: "button", onclick: () => {
      if (timer) { clearInterval(timer); timer = null; play.textContent = "Play"; return; }
      play.textContent = "Stop";
      timer = setInterval(() => { moment = (moment + 1) % moments.length; slider.value = moment; draw(); }, 400);
    } }, "Play");
    const [choose] = chooser("colour", names, (n) => { label = names[n]; draw(); });

    function draw() {
      const { kind, array: name, unit, low, high } = colours[label];
      const known = array(name);
      const at = (n) => known.row(n)[moment];
      const text = (n) => Number.isFinite(at(n)) ? `${label} ${shown(at(n))} ${unit}` : `${label} unknown`;
      output.textContent = moments[moment];
      slider.setAttribute("aria-valuetext", moments[moment]);
      const bar = { title: { text: `${label} [${unit}]`, side: "right" }, thickness: 14 };
      const traces = [];
      if (kind === "bus") {
        const [x, y] = [[], []];
        edges.forEach(([one, other]) => { x.push(places[one][0], places[other][0], null); y.push(places[one][1], places[other][1], null); });
        traces.push({ type: "scatter", mode: "lines", x, y, hoverinfo: "skip", line: { color: colour("faint"), width: 1 } });
      } else {
        // lines have one colour each, so the branches are sorted into steps of the scale
        const shades = ["#440154", "#46327e", "#365c8d", "#277f8e", "#1fa187", "#4ac16d", "#a0da39", "#fde725"];
        const groups = shades.map(() => [[], []]), unknown = [[], []];
        edges.forEach(([one, other], n) => {
          const share = (at(n) - low) / (high - low || 1);
          const group = Number.isFinite(share)
            ? groups[Math.max(0, Math.min(shades.length - 1, Math.floor(share * shades.length)))] : unknown;
          group[0].push(places[one][0], places[other][0], null);
          group[1].push(places[one][1], places[other][1], null);
        });
        [[unknown, colour("line")], ...groups.map((group, n) => [group, shades[n]])].forEach(([[x, y], shade]) =>
          traces.push({ type: "scatter", mode: "lines", x, y, hoverinfo: "skip", line: { color: shade, width: many ? 2 : 4 } }));
        traces.push({
          type: "scatter", mode: "markers", hoverinfo: "text",
          x: edges.map(([one, other]) => (places[one][0] + places[other][0]) / 2),
          y: edges.map(([one, other]) => (places[one][1] + places[other][1]) / 2),
          text: branches.map((branch, n) => `branch ${branch}<br>${text(n)}`),
          marker: { size: many ? 4 : 8, color: branches.map((_, n) => at(n)), cmin: low, cmax: high, colorscale: scale, colorbar: bar },
        });
      }
      const marker = kind === "bus"
        ? { size, color: buses.map((_, n) => at(n)), cmin: low, cmax: high, colorscale: scale, colorbar: bar,
            line: { width: 1, color: colour("paper") } }
        : { size: size * 0.7, color: colour("faint") };
      traces.push({
        type: "scatter", mode: many ? "markers" : "markers+text", x: places.map((p) => p[0]), y: places.map((p) => p[1]),
        text: buses, textposition: "top center", marker,
        hovertext: buses.map((bus, n) => kind === "bus" ? `bus ${bus}<br>${text(n)}` : `bus ${bus}`), hoverinfo: "text",
      });
      const hidden = { visible: false, range: [-0.06, 1.06] };
      Plotly.react(plot, traces, {
        ...themed({}, height), showlegend: false, hovermode: "closest",
        xaxis: { ...hidden, constrain: "domain" }, yaxis: { ...hidden, scaleanchor: "x" },
      }, config);
    }

    whenSeen(plot, draw);
    return element("figure", {},
      element("div", { class: "bar" }, element("h3", {}, title), choose),
      moments.length > 1 ? element("div", { class: "controls" }, play, slider, output) : undefined, plot);
  }

  // Studies -----------------------------------------------------------------------------------------

  function explorer({ title, axes, figures, rows, links }) {
    const plot = element("div", { class: "plot", style: "height:420px", role: "img", "aria-label": title });
    const palette = ["#0072B2", "#E69F00", "#009E73", "#D55E00", "#56B4E9", "#CC79A7", "#8C6D31", "#6B6ECF"];
    const nothing = "none";
    let x = axes[0] ?? "run", y = figures[0], by = nothing, spread = "points";
    const filters = Object.fromEntries(axes.map((axis) => [axis, "all"]));
    const text = (value) => value === null || value === undefined ? "none" : typeof value === "object" ? JSON.stringify(value) : String(value);
    const values = (axis) => [...new Set(rows.map((row) => text(row[axis])))];
    const chosen = new Set();
    const beside = element("div");

    function selected() {
      return rows.map((_, n) => n).filter((n) => axes.every((axis) => filters[axis] === "all" || text(rows[n][axis]) === filters[axis]));
    }

    function draw() {
      const groups = new Map();
      for (const n of selected()) {
        if (typeof rows[n][y] !== "number") continue;
        const key = by === nothing ? "" : text(rows[n][by]);
        if (!groups.has(key)) groups.set(key, []);
        groups.get(key).push(n);
      }
      const numeric = rows.every((row) => typeof row[x] === "number");
      const place = (n) => numeric ? rows[n][x] : text(rows[n][x]);
      const traces = [...groups].map(([key, members], number) => {
        const shade = palette[number % palette.length];
        const base = { name: key || y, marker: { color: shade, size: 9 } };
        if (spread === "box") return { ...base, type: "box", x: members.map(place), y: members.map((n) => rows[n][y]), boxpoints: "all" };
        if (spread === "points") {
          return { ...base, type: "scatter", mode: "markers", x: members.map(place), y: members.map((n) => rows[n][y]),
            text: members.map((n) => axes.map((axis) => `${axis} ${text(rows[n][axis])}`).join("<br>")), hovertemplate: "%{text}<br>%{y}<extra></extra>" };
        }
        const cells = new Map();
        members.forEach((n) => { const at = place(n); cells.set(at, [...(cells.get(at) ?? []), rows[n][y]]); });
        const at = [...cells.keys()].sort(numeric ? (a, b) => a - b : undefined);
        const mean = at.map((p) => cells.get(p).reduce((sum, v) => sum + v, 0) / cells.get(p).length);
        const deviation = at.map((p, n) => {
          const own = cells.get(p);
          return own.length < 2 ? 0 : Math.sqrt(own.reduce((sum, v) => sum + (v - mean[n]) ** 2, 0) / (own.length - 1));
        });
        return { ...base, type: "scatter", mode: "lines+markers", x: at, y: mean, line: { color: shade },
          error_y: { type: "data", array: deviation, color: shade } };
      });
      Plotly.react(plot, traces, themed({
        xaxis: { title: { text: x }, type: numeric ? "linear" : "category" }, yaxis: { title: { text: y } },
        boxmode: "group", showlegend: by !== nothing,
      }, 420), config);
    }

    function compare() {
      const members = [...chosen].sort((a, b) => a - b);
      if (members.length < 2) {
        beside.replaceChildren(element("p", { class: "notes mild" }, "Tick two or more runs to see them side by side."));
        return;
      }
      const names = members.map((n) => axes.map((axis) => text(rows[n][axis])).join(", ") || `run ${n + 1}`);
      beside.replaceChildren(table("Runs side by side", ["figure", ...names],
        figures.map((figure) => [figure, ...members.map((n) => rows[n][figure] ?? null)]), 200));
    }

    const list = element("div", { class: "scroll" });
    function fill() {
      const columns = [...axes, "status", y];
      list.replaceChildren(element("table", {}, element("caption", {}, "Runs"),
        element("thead", {}, element("tr", {}, element("th", { scope: "col" }, "compare"),
          ...columns.map((column) => element("th", { scope: "col" }, column)), element("th", { scope: "col" }, "report"))),
        element("tbody", {}, ...selected().map((n) => element("tr", {},
          element("td", {}, element("input", { type: "checkbox", "aria-label": `compare run ${n + 1}`,
            ...(chosen.has(n) ? { checked: "" } : {}),
            onchange: (event) => { event.target.checked ? chosen.add(n) : chosen.delete(n); compare(); } })),
          ...columns.map((column) => element("td", { class: typeof rows[n][column] === "number" ? "number" : undefined },
            typeof rows[n][column] === "object" && rows[n][column] !== null ? text(rows[n][column]) : shown(rows[n][column]))),
          element("td", {}, links[n] ? element("a", { href: links[n] }, "report") : ""))))));
    }

    const again = () => { draw(); fill(); };
    const kinds = ["points", "mean and deviation", "box"];
    const controls = [
      chooser("figure", figures, (n) => { y = figures[n]; again(); })[0],
      axes.length ? chooser("against", axes, (n) => { x = axes[n]; draw(); })[0] : undefined,
      chooser("colour", [nothing, ...axes], (n) => { by = [nothing, ...axes][n]; draw(); })[0],
      chooser("spread", kinds, (n) => { spread = ["points", "mean", "box"][n]; draw(); })[0],
    ];
    const sieve = axes.filter((axis) => values(axis).length > 1).map((axis) =>
      chooser(`only ${axis}`, ["all", ...values(axis)], (n) => { filters[axis] = ["all", ...values(axis)][n]; again(); })[0]);
    whenSeen(plot, draw);
    fill();
    compare();
    return element("figure", {}, element("h3", {}, title), element("div", { class: "bar" }, ...controls),
      element("div", { class: "bar" }, ...sieve), plot, beside, list);
  }

  // The page ----------------------------------------------------------------------------------------

  const menu = document.getElementById("menu");
  content.sections.forEach(({ title }) => {
    const id = title.toLowerCase().replace(/[^a-z0-9]+/g, "-");
    menu.append(element("li", {}, element("a", { href: `#${id}` }, title)));
    main.append(element("section", { id, "aria-labelledby": `${id}-title` }, element("h2", { id: `${id}-title` }, title)));
  });

  const packed = Uint8Array.from(atob(document.getElementById("plotly").textContent), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const script = element("script");
  script.textContent = await new Response(stream).text();
  document.head.append(script);

  const button = document.getElementById("theme");
  function theme(name) {
    root.dataset.theme = name;
    button.textContent = name === "dark" ? "Light" : "Dark";
    button.setAttribute("aria-label", name === "dark" ? "Light colours" : "Dark colours");
    button.setAttribute("aria-pressed", String(name === "dark"));
    drawn.forEach((draw) => draw());
  }
  theme(window.matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  button.addEventListener("click", () => theme(root.dataset.theme === "dark" ? "light" : "dark"));

  const sections = main.querySelectorAll("section");
  content.sections.forEach(({ parts: own }, n) =>
    own.forEach((part) => sections[n].append(parts[part.part](part))));
  root.dataset.ready = "true";
})();
