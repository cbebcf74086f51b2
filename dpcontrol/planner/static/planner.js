// The planner's page. It holds no physics: Python sends places and figures, and this draws them.
// `got` is what was sent last of each kind; `state` is the itinerary and the work on it.
const role = (name) => document.querySelector(`[data-role="${name}"]`);
const id = (name) => document.getElementById(name);
const all = (selector) => [...document.querySelectorAll(selector)];
const FINE = 1e4; // places come in tenths of a millimetre
const got = { models: [] };
let state = { walk: [], wraps: [], names: [], busy: { what: "connecting", done: 0 } };
let hovered = null, chosen = null; // names of connections: pointed at now, and last
let kind = null, view = null; // the section that is shown, and what part of it
let showing = "connection", time = 0, tileTime = 0, last = 0; // whose motion, and when
let playing = !matchMedia("(prefers-reduced-motion: reduce)").matches;
let nodes = {}, arrows = []; // the graph, laid out
window.planner = { get state() { return state; } };
const title = (saddle = "") => saddle.replace(/(^|-)(\w)/g, (_, dash, c) => dash + c.toUpperCase());
const between = (one) => (one.source === one.target ? `${title(one.source)} ↺`
  : `${title(one.source)} → ${title(one.target)}`);
const sameKind = (one, other) => one?.source === other?.source && one?.target === other?.target;
const connections = () => got.atlas?.connections ?? [];
const named = (name) => connections().find((one) => one.name === name);
const shownOnes = () => connections().filter((one) => sameKind(one, kind));
// Recommended of each kind, and of each sense if it returns: symmetric and most transversal.
const bestOf = ({ source, target }) => (source === target
  ? [`${source} +`, `${source} -`] : [`${source} > ${target}`]).filter((text) => symbols()[text]);
const symbols = () => got.atlas?.symbols ?? {};
const isBest = (one) => bestOf(one).some((text) => symbols()[text] === one.name);
const better = (one, other) => isBest(other) - isBest(one) || other.angle - one.angle;
const figures = (one) => `${one.angle.toFixed(1)}°  ${one.time.toFixed(2)} s`;
const digits = (value, count = 3) => `${+value.toPrecision(count)}`;
let socket = null, sent = 0; // commands sent
const waiting = [], changing = new Set(); // commands, and inputs that are still being changed
let pressed = false; // an element under a pressed pointer must stay, or its click is lost
// Commands say what was done, and the server does it in order: none is computed from `state`.
function send(what, given = {}) {
  for (const finish of changing) finish();
  // Text is typed only into the text that all earlier commands have made.
  role("toml").readOnly = document.activeElement !== role("toml");
  state = { ...state, late: true, busy: state.busy || { what, done: 0 } };
  if (socket?.readyState === WebSocket.OPEN) post({ do: what, ...given });
  else waiting.push({ do: what, ...given });
}
function post(command) {
  sent += 1;
  socket.send(JSON.stringify({ ...command, n: sent }));
}
const set = (values, table = "") => send("set", { table, values });
function connect() {
  const page = encodeURIComponent(window.name);
  socket = new WebSocket(`ws://${location.host}/page/${page}${location.search}`);
  socket.onopen = () => { sent = 0; waiting.splice(0).forEach(post); };
  socket.onmessage = (event) => {
    const [[word, value]] = Object.entries(JSON.parse(event.data));
    if (word === "state") takeState(value);
    else got[word] = value;
    taken[word]?.(value);
    render();
  };
  socket.onclose = () => {
    say("the planner's program has ended: start `dpcontrol planner` again", "error");
    setTimeout(connect, 1000);
  };
}
const taken = {
  atlas() {
    hovered = null;
    chosen = connections()[0]?.name;
    const { kinds } = got.atlas;
    showKind(kinds.find((one) => sameKind(one, kind))
      ?? kinds.find((one) => one.source !== one.target) ?? kinds[0]);
  },
  plan: () => show("plan"),
  run: () => show("run"),
  page(picture) {
    if (!state.toml) return; // after a reload the drawing stays closed
    id("paper").querySelector("img").src = picture;
    id("paper").showModal();
  },
};
function takeState(value) {
  // Until the server has taken the last command, work is under way.
  const late = changing.size > 0 || value.ack < sent;
  const before = state.busy ?? { what: "…", done: 0 };
  state = { ...value, late, busy: value.busy ?? (late ? before : null) };
  const { atlas } = got;
  const other = state.model !== atlas?.model && !state.mistake;
  if (atlas && (state.energy !== atlas.energy || other)) {
    got.atlas = hovered = chosen = null;
  }
  if (!state.plan?.converged) got.plan = null;
  if (!state.run) got.run = null;
  if (!state.seeds && !state.busy) got.seeds = null;
  if (showing !== "connection" && !got[showing]) show(got.plan ? "plan" : "connection");
}
function make(tag, { data, ...given } = {}, ...children) {
  const made = Object.assign(document.createElement(tag), given);
  Object.assign(made.dataset, data);
  made.append(...children);
  return made;
}

// Replace what an element holds if that has changed; the focus stays where it was.
function fill(element, key, content) {
  const text = JSON.stringify(key);
  if (element.shows === text || (pressed && element.shows)) return;
  element.shows = text;
  const active = element.contains(document.activeElement) ? document.activeElement.dataset : {};
  const where = Object.entries(active).map(([name, is]) => `[data-${name}="${CSS.escape(is)}"]`);
  element.replaceChildren(...content());
  if (where.length) element.querySelector(where.join(""))?.focus();
}

// Set an input's value unless the user has changed it and is at it, or has just emptied it.
function keep(input, value) {
  const text = String(value), changed = input.value !== input.kept && input.type !== "range";
  const away = !changed || document.activeElement !== input;
  if (input.value === text) input.kept = text;
  if (!away || state.late || input.value === text) return;
  if (input.value !== "" || input.kept !== text) input.value = input.kept = text;
}
const say = (text, look = "") =>
  Object.assign(role("status"), { textContent: text, title: text, className: look });
function tab(text, selected, onclick) {
  const made = make("button", { textContent: text, onclick, role: "tab", data: { tab: text } });
  made.ariaSelected = selected;
  return made;
}

const WORK = { connecting: "Connecting", atlas: "Finding connections", plan: "Planning",
  run: "Running", seeds: "Running 20 seeds", page: "Drawing the page", film: "Filming",
  rerun: "Opening the viewer" };
const KINDS = { centre: "at rest", "index-2 saddle": "no orbit" };
// Return the likely rest of a job's duration: as expected, and later by its progress so far.
let job = null, begun = 0;
function left(busy) {
  if (job !== (busy?.kind ?? null)) [job, begun] = [busy?.kind ?? null, performance.now()];
  if (!busy?.kind) return "";
  const passed = (performance.now() - begun) / 1000, { done, seconds } = busy;
  if (!seconds && (done < 0.1 || passed < 2)) return "";
  const weight = seconds ? Math.min(2 * done, 1) : 1;
  const total = (1 - weight) * seconds + (done > 0 ? weight * (passed / done) : 0);
  const rest = total - passed;
  if (rest < 5) return "a few seconds left";
  return rest < 90 ? `about ${5 * Math.ceil(rest / 5)} s left`
    : `about ${Math.ceil(rest / 60)} min left`;
}

function render() {
  const { busy, message, atlas } = { ...state, ...got };
  id("busy").hidden = !busy;
  id("busy").querySelector("progress").value = busy?.done ?? 0;
  id("what").textContent = busy ? WORK[busy.kind] ?? busy.what : "";
  id("what").title = busy?.what ?? "";
  id("left").textContent = left(busy);
  const about = atlas ? `${atlas.orbits.length} orbits and ${connections().length
  } connections at ${atlas.energy} J` : "";
  if (message) say(message.text || about, message.kind);
  if (message && !message.text) role("status").title = atlas?.status ?? "";
  const free = state.whole && !state.working;
  const seen = state.run && free, { whole: save, undo, redo, fixed } = state;
  const next = !state.plan?.converged ? "plan" : state.run ? "save" : "run";
  for (const name of ["plan", "run", "save"]) role(name).classList.toggle("main", name === next);
  const able = { plan: free, run: free, seeds: free, page: seen, rerun: seen, film: seen,
    save, undo, redo, start: !fixed, finish: !fixed };
  for (const [name, is] of Object.entries(able)) role(name).disabled = !is;
  role("retry").hidden = !state.retry;
  keep(role("energy"), state.energy ?? "");
  keep(id("slider"), state.energy ?? 0);
  keep(role("toml"), state.toml ?? "");
  keep(role("name"), state.name ?? "");
  role("toml").readOnly &&= Boolean(state.late);
  for (const which of ["start", "finish"]) keep(role(which), state[which]);
  for (const input of all("input[data-key]")) {
    const value = state.settings?.[input.dataset.key];
    keep(input, value === undefined ? "" : digits(value * input.dataset.factor, 6));
  }
  for (const part of [renderModels, renderEnergy, renderTiles, renderKinds, renderList, renderWalk,
    renderLines, renderPlan, renderRun]) part();
  const motions = ["connection", "plan", "run"].filter((one) => one === "connection" || got[one]);
  fill(id("shows"), [motions, showing], () => motions.map((one) =>
    tab(title(one), one === showing, () => show(one))));
  layGraph();
  drawStill();
}
function renderModels() {
  fill(role("model"), [got.models, state.model], () => got.models.map((one) => make("option", {
    value: one.name, textContent: one.name, title: one.problem,
    disabled: Boolean(one.problem), selected: one.name === state.model })));
}
function renderEnergy() {
  if (!got.model) return;
  const { energies: [low, high], points, name } = got.model;
  Object.assign(id("slider"), { min: low, max: high });
  const mark = (energy, className, text, hint) => {
    const made = make("b", { className, title: hint }, make("span", { textContent: text }));
    made.style.left = `${Math.max((100 * (energy - low)) / (high - low), 0)}%`;
    return made;
  };
  fill(id("marks"), [name], () => points.filter((one) => one.kind.startsWith("index-1")).map(
    (one) => mark(one.energy, "saddle", title(one.name),
      `${digits(one.energy, 6)} J: orbits begin`)));
}
function renderTiles() {
  if (!got.model) return;
  const orbits = got.atlas?.orbits ?? [];
  const why = Object.fromEntries((got.atlas?.absent ?? []).map((one) => [one.saddle, one.reason]));
  const tile = (point, orbit) => {
    const canvas = make("canvas");
    canvas.look = { frames: orbit?.frames ?? [point.frame], period: orbit?.period ?? 1 };
    return make("button", { className: "tile", data: { saddle: point.name },
      title: why[point.name] ?? `${point.kind} at ${digits(point.energy, 6)} J`,
      onclick: () => showKind(got.atlas?.kinds.find((one) => one.source === point.name)) },
    canvas, make("span", { textContent: title(point.name) }), make("small", {
      textContent: orbit ? `orbit ${orbit.period.toFixed(2)} s`
        : KINDS[point.kind] ?? "no orbit" }));
  };
  fill(id("tiles"), [got.model.points, orbits.map((one) => [one.name, one.period])], () =>
    got.model.points.flatMap((point) => {
      const own = orbits.filter((one) => one.saddle === point.name);
      return own.length ? own.map((orbit) => tile(point, orbit)) : [tile(point)];
    }));
}
function renderKinds() {
  fill(id("kinds"), [got.atlas?.kinds.map(between), kind && between(kind)], () =>
    (got.atlas?.kinds ?? []).map((one) =>
      tab(between(one), sameKind(one, kind), () => showKind(one))));
  id("unstable").textContent = kind ? `leaving ${title(kind.source)}` : "";
  id("stable").textContent = kind ? `joining ${title(kind.target)}` : "";
}

// Why a connection cannot be the walk's next one, or "".
function refusal(one) {
  const at = state.stops?.at(-1);
  const why = `leaves ${title(one.source)}; the walk is at ${title(at)}`;
  return state.fixed || !at || one.source === at ? state.fixed ?? "" : why;
}
const append = (name) => name && send("append", { symbol: name });
function renderList() {
  const at = state.stops?.at(-1), all = got.atlas?.kinds ?? [];
  const legal = (group) => !state.fixed && (!at || group.source === at);
  const order = (group) => 2 * !legal(group) + (group.source === group.target);
  const count = all.filter(legal).flatMap((group) =>
    connections().filter((one) => sameKind(one, group))).length;
  id("count").textContent = at ? `${count} next` : `${count || ""}`;
  const names = connections().map((one) => one.name);
  fill(id("list"), [names, at, state.fixed, state.names], () =>
    [...all].sort((a, b) => order(a) - order(b)).flatMap((group) => [
      make("h3", { textContent: between(group), className: legal(group) ? "" : "other" }),
      ...connections().filter((one) => sameKind(one, group)).sort(better).map((one) => {
        const why = refusal(one), used = state.names.includes(one.name);
        const made = make("button", { data: { role: "connection", name: one.name },
          title: why || `${isBest(one) ? "Recommended: symmetric and most transversal. " : ""
          }${one.name}`, className: `${used ? "used " : ""}${isBest(one) ? "best" : ""}`,
          onclick: () => append(one.name), onmouseenter: () => hover(one.name),
          onmouseleave: () => hover(null), onfocus: () => hover(one.name),
        }, make("span", { textContent: one.turns }), make("small", { textContent: figures(one) }));
        made.ariaDisabled = Boolean(why);
        return made;
      })]));
  // What can follow is at the top.
  if (id("list").at !== at) id("list").scrollTop = 0;
  id("list").at = at;
}
// A walk there and back by recommended connections, or twice around if there is no way there.
function example() {
  const { kinds } = got.atlas, there = kinds.find((one) => one.source !== one.target) ?? kinds[0];
  const back = { source: there.target, target: there.source };
  const chosen = [bestOf(there)[0], bestOf(back).at(-1)];
  for (const symbol of chosen) send("append", { symbol });
}
const welcome = () => make("li", { className: "hint" },
  make("p", { textContent: "Only the cart is driven; the arms swing freely. At this energy they "
    + "can circle an unstable position and pass on to another. To plan such a motion:" }),
  make("ol", {}, make("li", { textContent: "Choose an energy." }),
    make("li", {}, "Click connections, one after the other. ", make("span", { className: "star",
      textContent: "★" }), " is a good choice; point at one to see it move."),
    make("li", { textContent: "Plan: how must the cart move?" }),
    make("li", { textContent: "Run it on simulated arms that are not as assumed." }),
    make("li", { textContent: "Save the itinerary and its run." })),
  make("button", { className: "main", data: { role: "example" }, textContent: "Show an example",
    disabled: !got.atlas?.kinds.length || Boolean(state.fixed), onclick: example }));
function renderWalk() {
  const { walk, wraps, stops, names, unknown, plan, fixed } = state;
  const key = [walk, wraps, stops, names, unknown, plan?.fault, fixed, got.atlas?.energy,
    got.atlas?.model];
  fill(id("walk"), key, () => {
    if (!walk.length) return [welcome()];
    const rows = walk.map((text, k) => make("li", { title: text, data: { name: names[k] },
      className: k === plan?.fault || unknown.includes(k) ? "symbol fault" : "symbol",
      onmouseenter: () => hover(names[k]), onmouseleave: () => hover(null),
    }, `${k + 1}. ${stops.length ? between({ source: stops[k], target: stops[k + 1] }) : text}`,
    make("small", {
      textContent: unknown.includes(k) ? "not at this energy" : named(names[k])?.turns })));
    const button = (which, textContent, more, stop) => make("button", { textContent,
      data: { role: `wraps-${which}`, stop }, disabled: Boolean(fixed || wraps[stop] + more < 0),
      ariaLabel: `${more > 0 ? "One more wrap" : "One wrap less"} at stop ${stop + 1}`,
      onclick: () => send("wraps", { stop, change: more }) });
    rows.at(-1).append(make("button", { className: "far", textContent: "✕", ariaLabel: "Remove",
      title: "Remove the last symbol", disabled: Boolean(fixed), data: { role: "shorten" },
      onclick: () => send("shorten") }));
    return rows.flatMap((row, k) => (k === rows.length - 1 ? [row] : [row,
      make("li", { className: "stop", title: "Times around the orbit before going on" },
        `wraps at ${title(stops[k + 1])}`,
        button("minus", "−", -1, k), make("b", { textContent: wraps[k] ?? "?" }),
        button("plus", "+", 1, k))]));
  });
}
function renderLines() {
  const { line, message } = state.mistake ?? {}, count = role("toml").value.split("\n").length;
  Object.assign(id("mistake"), { hidden: !line, textContent: `Line ${line}: ${message}` });
  fill(id("lines"), [count, line], () => Array.from({ length: count }, (_, k) =>
    make(k + 1 === line ? "b" : "span", { textContent: k + 1 })));
  id("lines").scrollTop = role("toml").scrollTop;
}
function renderPlan() {
  const { plan } = state;
  fill(id("plan"), [plan, state.walk.length], () => {
    if (!plan) return [make("p", { className: "quiet", textContent: state.walk.length
      ? "Plan computes how the cart must move." : "" })];
    if (!plan.converged) return [make("p", { className: "bad", textContent: plan.status }),
      ...(plan.wraps ? [make("button", { textContent: `Use wraps [${plan.wraps}]`,
        onclick: () => set({ wraps: plan.wraps }) })] : [])];
    return [make("div", { className: "uses" }, ...plan.uses.flatMap((use) => [
      make("span", { textContent: use.name }),
      make("meter", { max: use.bound, high: 0.95 * use.bound, value: use.largest,
        title: `at ${use.time.toFixed(2)} s` }),
      make("span", { textContent: `${digits(use.largest)} of ${use.bound} ${use.unit}` })]),
    make("span", { textContent: "effort" }), make("span", {
      textContent: `${digits(plan.effort)} m²/s³ in ${plan.duration.toFixed(1)} s` }))];
  });
}
function renderRun() {
  const { run } = state, { seeds } = got, milli = (value) => digits(1e3 * value);
  fill(id("run"), [run], () => (run ? [
    make("p", { className: run.completed ? "good" : "bad", textContent: run.sentence }),
    make("p", { className: "quiet", textContent: `tracking ${milli(run.rms_tracking_error)
    } mrad rms, cart ${milli(run.max_cart_position)} mm at most` })] : []));
  const text = seeds ? `${seeds.filter(Boolean).length} of ${seeds.length}` : "";
  Object.assign(id("bar"), { hidden: !seeds, ariaLabel: `${text} runs completed` });
  fill(id("bar"), [seeds], () => (seeds ? [...Array.from({ length: 20 }, (_, k) =>
    make("i", { className: k < seeds.length ? (seeds[k] ? "good" : "bad") : "" })), text] : []));
}
function showKind(to) {
  if (to && !sameKind(to, kind)) view = null;
  kind = to ?? kind;
  render();
}
function hover(name) {
  if (name === hovered) return;
  hovered = name;
  const one = named(name);
  if (one) {
    chosen = name;
    time = 0;
    if (!sameKind(one, kind)) showKind(got.atlas.kinds.find((each) => sameKind(each, one)));
  }
  for (const each of all("#list button, #walk li")) {
    each.classList.toggle("hot", name !== null && each.dataset.name === name);
  }
  drawStill();
}
function show(what) {
  [showing, time, hovered] = [what, 0, null];
  render();
}
const colours = {};
function recolour() {
  const probe = make("i");
  document.body.append(probe);
  for (const name of ["ink", "quiet", "line", "panel", "sunk", "accent", "unstable", "stable",
    "outer", "ghost"]) {
    probe.style.color = `var(--${name})`;
    colours[name] = getComputedStyle(probe).color;
  }
  probe.remove();
  drawStill();
}

const sharp = (canvas) => Math.min(devicePixelRatio * (canvas.currentCSSZoom ?? 1), 2);

// Return a canvas's context in CSS pixels, cleared, with its size.
function ready(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas;
  const scale = sharp(canvas);
  const [wide, high] = [Math.round(width * scale), Math.round(height * scale)];
  if (canvas.width !== wide) canvas.width = wide;
  if (canvas.height !== high) canvas.height = high;
  const pen = canvas.getContext("2d");
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = "12px system-ui, DejaVu Sans, sans-serif";
  pen.lineJoin = pen.lineCap = "round";
  return { pen, width, height };
}
function line(pen, points, colour, width = 1, dash = []) {
  pen.beginPath();
  points.forEach(([x, y], k) => (k ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  Object.assign(pen, { strokeStyle: colour, lineWidth: width });
  pen.setLineDash(dash);
  pen.stroke();
}
function disc(pen, x, y, radius, fill, edge = null, width = 1.5) {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 2 * Math.PI);
  Object.assign(pen, { fillStyle: fill, strokeStyle: edge, lineWidth: width });
  pen.setLineDash([]);
  if (fill) pen.fill();
  if (edge) pen.stroke();
}
function write(pen, text, x, y, align = "center", baseline = "middle", colour = colours.quiet) {
  Object.assign(pen, { textAlign: align, textBaseline: baseline, fillStyle: colour });
  pen.fillText(text, x, y);
}
const nothing = ({ pen, width, height }) =>
  write(pen, state.busy ? `${WORK[state.busy.kind] ?? state.busy.what} …`
    : "no connections at this energy", width / 2, height / 2);
const LEFT = 46, RIGHT = 8, TOP = 6, BOTTOM = 30; // around the section
function scales() {
  const { clientWidth, clientHeight } = id("section");
  const [width, height] = [clientWidth - LEFT - RIGHT, clientHeight - TOP - BOTTOM];
  return { width, height, perX: (2 * view.wide) / width, perY: (2 * view.high) / height,
    x: (q) => LEFT + width * (0.5 + (q - view.x) / (2 * view.wide)),
    y: (p) => TOP + height * (0.5 - (p - view.y) / (2 * view.high)) };
}
function drawStill() {
  drawSection();
  drawGraph();
}
function drawSection() {
  const area = ready(id("section")), { pen } = area;
  if (!kind || !got.atlas) return nothing(area);
  const reach = (k) =>
    1.1 * Math.max(...kind.curves.flatMap((one) => one.points.map((p) => Math.abs(p[k]))));
  view ??= { x: 0, y: 0, wide: kind.period ? 0.52 * kind.period : reach(0), high: reach(1) };
  const at = scales(), place = ([q, p]) => [at.x(q), at.y(p)];
  pen.save();
  pen.beginPath();
  pen.rect(LEFT, TOP, at.width, at.height);
  pen.fillStyle = colours.sunk;
  pen.fill();
  pen.clip();
  for (const { stable, forward, points } of kind.curves) {
    const colour = colours[stable ? "stable" : "unstable"];
    line(pen, points.map(place), colour, 1.5, forward ? [] : [5, 3]);
  }
  for (const one of shownOnes()) {
    const [x, y] = place(one.place), hot = one.name === hovered;
    pen.globalAlpha = refusal(one) && !hot ? 0.35 : 1;
    if (state.names.includes(one.name)) disc(pen, x, y, 8.5, null, colours.accent, 2);
    disc(pen, x, y, hot ? 7 : 4.5, colours[hot ? "outer" : "accent"], colours.panel);
  }
  pen.restore();
  const angles = { [-2]: "−π", [-1]: "−π/2", 0: "0", 1: "π/2", 2: "π" };
  const [bottom, wide] = [TOP + at.height, kind.period && view.wide > 0.8];
  for (const q of ticks(view.x - view.wide, view.x + view.wide, wide ? Math.PI / 2 : 0)) {
    const text = wide ? angles[Math.round(q / (Math.PI / 2))] ?? "" : digits(q);
    write(pen, text, at.x(q), bottom + 3, "center", "top");
  }
  for (const p of ticks(view.y - view.high, view.y + view.high)) {
    write(pen, digits(p), LEFT - 5, at.y(p), "right");
  }
  const text = `${kind.coordinate} on the section${kind.period ? " (rad)" : ""}`;
  write(pen, text, LEFT + at.width / 2, bottom + 30, "center", "bottom");
  write(pen, "p / p₀", LEFT + 6, TOP + 4, "left", "top");
}
function ticks(low, high, step = 0) {
  const raw = (high - low) / 5, power = 10 ** Math.floor(Math.log10(raw));
  const each = step || power * [1, 2, 5, 10].find((one) => one * power >= raw);
  const first = Math.ceil(low / each), count = Math.max(Math.floor(high / each) - first + 1, 0);
  return Array.from({ length: count }, (_, k) => (first + k) * each);
}

// The graph: orbits as nodes. Connections with the same ends and turns share an arrow, which
// stands for the best of them. Arrows between orbits bow out, those that return are petals.
const NODE = 17;
function bundles(group) {
  const own = connections().filter((one) => sameKind(one, group)).sort(better);
  return [...new Set(own.map((one) => one.turns))].map((turns) =>
    own.filter((one) => one.turns === turns));
}
function layGraph() {
  const { clientWidth: width, clientHeight: height } = id("graph");
  const names = [...new Set((got.atlas?.orbits ?? []).map((one) => one.saddle))];
  const alone = names.length < 2;
  nodes = Object.fromEntries(names.map((name, k) =>
    [name, [width * (alone ? 0.5 : 0.3 + (0.4 * k) / (names.length - 1)), height / 2]]));
  const size = Math.min(0.25 * width - 16, 0.4 * height) / 0.72;
  arrows = (got.atlas?.kinds ?? []).flatMap((group) => {
    const [from, to] = [nodes[group.source], nodes[group.target]];
    return bundles(group).map((own, k, { length }) => {
      const spread = alone ? (2 * Math.PI) / length : Math.min(3.9 / length, 1.1);
      const away = alone || from[0] > width / 2 ? 0 : Math.PI;
      const angle = away + (k - (length - 1) / 2) * spread;
      const petal = (turn) => [0, 1].map((i) =>
        from[i] + size * [Math.cos, Math.sin][i](angle + turn * Math.min(0.42 * spread, 0.45)));
      const [dx, dy] = [to[0] - from[0], to[1] - from[1]];
      // The farthest arrow stays within the picture.
      const most = (height / 2 - 16) / (0.75 * Math.hypot(dx, dy));
      const bow = 0.16 + k * Math.min(0.4, (most - 0.16) / Math.max(length - 1, 1));
      const arch = ([x, y], along) => [x + dx * along + dy * bow, y + dy * along - dx * bow];
      const ends = from === to ? [petal(-1), petal(1)] : [arch(from, 0.3), arch(from, 0.7)];
      const path = new Path2D();
      path.moveTo(...from);
      path.bezierCurveTo(...ends[0], ...ends[1], ...to);
      // The number of those that return stands beyond their tip.
      const middle = [0, 1].map((i) => (from[i] + to[i] + 3 * (ends[0][i] + ends[1][i])) / 8)
        .map((place, i) => (from === to ? from[i] + 1.32 * (place - from[i]) : place));
      return { one: own[0], own, path, to, middle,
        angle: Math.atan2(to[1] - ends[1][1], to[0] - ends[1][0]) };
    });
  });
}
function drawGraph() {
  const area = ready(id("graph")), { pen } = area;
  if (!got.atlas) return nothing(area);
  const rank = ({ own }) => (own.some((one) => one.name === hovered) ? 2
    : Number(own.some((one) => state.names.includes(one.name))));
  for (const item of [...arrows].sort((a, b) => rank(a) - rank(b))) {
    const { one, own, path, to, angle, middle } = item;
    const colour = colours[["quiet", "accent", "outer"][rank(item)]];
    pen.globalAlpha = refusal(one) && rank(item) < 2 ? 0.35 : 1;
    Object.assign(pen, { strokeStyle: colour,
      lineWidth: (rank(item) ? 1.2 : 0) + 1 + 0.5 * Math.log2(own.length) });
    pen.setLineDash([]);
    pen.stroke(path);
    const tip = [0, 1].map((i) => to[i] - (NODE + 3) * [Math.cos, Math.sin][i](angle));
    pen.beginPath();
    for (const turn of [0, 2.6, -2.6]) {
      pen.lineTo(tip[0] + 6 * Math.cos(angle + turn), tip[1] + 6 * Math.sin(angle + turn));
    }
    pen.fillStyle = colour;
    pen.fill();
    if (own.length > 1) {
      if (one.source !== one.target) disc(pen, ...middle, 8, colours.panel);
      const ink = colours[rank(item) ? "ink" : "quiet"];
      write(pen, `×${own.length}`, ...middle, "center", "middle", ink);
    }
  }
  pen.globalAlpha = 1;
  pen.font = "600 10.5px system-ui, DejaVu Sans, sans-serif";
  for (const [name, [x, y]] of Object.entries(nodes)) {
    const here = state.stops?.at(-1) === name;
    disc(pen, x, y, NODE, colours[here ? "accent" : "panel"], colours[here ? "accent" : "ink"]);
    title(name).split("-").forEach((word, k) =>
      write(pen, word, x, y + 11 * k - 5, "center", "middle", colours[here ? "panel" : "ink"]));
  }
}

// Return the joints at a time, between two frames.
function jointsAt({ frames, rate }, seconds) {
  const place = Math.max(Math.min(seconds * rate, frames.length - 1), 0);
  const k = Math.min(Math.floor(place), frames.length - 2), part = place - k;
  return k < 0 ? frames[0] : frames[k].map((value, j) => value + part * (frames[k + 1][j] - value));
}
function drawArms(pen, joints, at, width, colour = null) {
  const points = [[joints[0], 0]];
  for (let k = 1; k < joints.length; k += 2) points.push([joints[k], joints[k + 1]]);
  const places = points.map(([x, y]) => [at.x(x), at.y(y)]);
  const look = ["ink", "accent", "outer"];
  places.forEach(([x, y], k) => {
    if (k) line(pen, [places[k - 1], [x, y]], colour ?? colours[look[k]], width);
  });
  places.forEach(([x, y], k) => disc(pen, x, y, 0.8 * width, colour ?? colours[look[k]]));
}

function drawStage() {
  const area = ready(id("stage")), { pen, width, height } = area, one = named(hovered ?? chosen);
  const value = hovered || showing === "connection" ? null : got[showing], now = value ?? one;
  id("strip").hidden = !value;
  if (!now || !got.model) return nothing(area);
  const { motion } = now, travel = value?.travel ?? 0, reach = 1.08 * got.model.reach;
  const duration = (motion.frames.length - 1) / motion.rate;
  if (playing) time = (time + Math.min(tileTime - last, 0.1)) % duration;
  const scale = Math.min(height / (2 * reach), width / (2 * (travel + reach))) / FINE;
  const at = { x: (x) => width / 2 + scale * x, y: (y) => height / 2 - scale * y };
  const tips = (frames) => frames.map((frame) => [at.x(frame.at(-2)), at.y(frame.at(-1))]);
  const stops = value ? [at.x(-travel * FINE), at.x(travel * FINE)] : [];
  line(pen, stops.map((x) => [x, at.y(0)]), colours.line, 3);
  for (const x of stops) line(pen, [[x, at.y(0) - 12], [x, at.y(0) + 12]], colours.unstable, 2);
  if (!value) line(pen, tips(motion.frames), colours.line, 1.5);
  const joints = jointsAt(motion, time), until = Math.floor(time * motion.rate) + 1;
  const trail = motion.frames.slice(Math.max(until - 30, 0), until);
  line(pen, tips([...trail, joints]), colours.outer, 1.5);
  if (value?.ghost) drawArms(pen, jointsAt(value.ghost, time), at, 4, colours.ghost);
  pen.fillStyle = colours.quiet;
  if (value) pen.fillRect(at.x(joints[0]) - 13, at.y(0) - 5, 26, 10);
  drawArms(pen, joints, at, 5);
  const ghost = value?.ghost ? "; grey: the reference" : "";
  const caption = value ? `${value.duration.toFixed(1)} s${ghost}`
    : `${between(one)}, ${one.turns}, ${figures(one)}`;
  if (id("caption").textContent !== caption) id("caption").textContent = caption;
  if (value) drawStrip(value);
}

// The cart's path over time, within its limits; a click goes to that moment.
function drawStrip(value) {
  const { pen, width, height } = ready(id("strip")), { travel, duration, series, motion } = value;
  const x = (seconds) => LEFT + ((width - LEFT - RIGHT) * seconds) / duration;
  const y = (metres) => height / 2 - 8 - (metres / travel) * (height / 2 - 14);
  for (const bound of [-travel, travel]) {
    line(pen, [[x(0), y(bound)], [x(duration), y(bound)]], colours.unstable, 1, [4, 3]);
    write(pen, `${digits(bound, 2)} m`, LEFT - 5, y(bound), "right");
  }
  write(pen, "cart", LEFT - 5, y(0), "right");
  for (const [name, colour, wide] of [["reference", "ghost", 3], ["position", "accent", 1.5]]) {
    value[name] ??= (series[name] ?? []).map((one, k) => [k / motion.rate, one])
      .filter((_, k) => k % 4 === 0);
    line(pen, value[name].map(([when, where]) => [x(when), y(where)]), colours[colour], wide);
  }
  for (const when of ticks(0, duration)) {
    write(pen, `${digits(when)} s`, x(when), height, "center", "bottom");
  }
  for (const { time: when } of value.symbols ?? []) {
    line(pen, [[x(when), height - 19], [x(when), height - 14]], colours.ink, 2);
  }
  line(pen, [[x(time), 2], [x(time), height - 14]], colours.outer, 1.5);
}
function drawTiles() {
  for (const canvas of got.model ? all(".tile canvas") : []) {
    const { pen, width, height } = ready(canvas), { frames, period } = canvas.look;
    const scale = height / (2.2 * got.model.reach * FINE);
    const at = { x: (x) => width / 2 + scale * x, y: (y) => height / 2 - scale * y };
    // An orbit's last sample is one step before its first.
    const closed = { frames: [...frames, frames[0]], rate: frames.length / period };
    const colour = frames.length > 1 ? null : colours.ghost;
    drawArms(pen, jointsAt(closed, tileTime % period), at, 3, colour);
  }
}
function frame(now) {
  if (playing) tileTime = now / 1000;
  drawTiles();
  drawStage();
  last = tileTime;
  requestAnimationFrame(frame);
}

// Act when an input has not been changed for a while; until then the page is busy.
function after(wait, act) {
  let timer = 0, given = null;
  const finish = () => {
    clearTimeout(timer);
    changing.delete(finish);
    act(given);
  };
  return (latest, delay = wait) => {
    given = latest;
    changing.add(finish);
    state = { ...state, late: true, busy: state.busy ?? { what: "…", done: 0 } };
    clearTimeout(timer);
    timer = setTimeout(finish, delay);
  };
}
const setEnergy = after(400, (text) => {
  // What is no number, as while it is typed, is answered with the energy as it is.
  set(text === "" || !Number.isFinite(Number(text)) ? {} : { energy: Number(text) });
});
for (const [input, other] of [[role("energy"), id("slider")], [id("slider"), role("energy")]]) {
  input.oninput = () => { other.value = input.value; setEnergy(input.value); };
  input.onchange = () => input.value && setEnergy(input.value, 0);
}
role("model").onchange = (event) => send("model", { name: event.target.value });
for (const which of ["start", "finish"]) {
  role(which).onchange = (event) => set({ [which]: event.target.value });
}
const setText = after(100, () => send("toml", { text: role("toml").value }));
role("toml").oninput = () => { renderLines(); setText(); };
role("toml").onscroll = () => { id("lines").scrollTop = role("toml").scrollTop; };
for (const input of all("input[data-key]")) {
  input.onchange = () => {
    const value = Number(input.value) / input.dataset.factor;
    if (input.value !== "") set({ [input.dataset.key]: value }, "run");
  };
}
role("name").onchange = ({ target }) => target.value && send("name", { name: target.value });
role("run").onclick = () => send("run", { seed: Number(role("seed").value) });
for (const name of ["plan", "save", "undo", "redo", "cancel", "film", "seeds", "page", "rerun",
  "retry"]) role(name).onclick = () => send(name);
id("play").onclick = () => {
  playing = !playing;
  id("play").textContent = playing ? "❚❚" : "▶";
};
const local = ({ clientX, clientY, currentTarget: { clientWidth }, currentTarget }) => {
  const { left, top, width } = currentTarget.getBoundingClientRect();
  return [clientX - left, clientY - top].map((one) => (one * clientWidth) / width);
};
function pointAt([x, y]) {
  const at = scales(), far = ({ place: [q, p] }) => Math.hypot(at.x(q) - x, at.y(p) - y);
  return shownOnes().sort((a, b) => far(a) - far(b)).find((one) => far(one) < 10)?.name ?? null;
}
function arrowAt([x, y]) {
  const pen = id("graph").getContext("2d"), scale = sharp(id("graph"));
  const within = (width, among = arrows) => among.find(({ path }) => {
    pen.lineWidth = width;
    return pen.isPointInStroke(path, x * scale, y * scale);
  });
  // An arrow that is pointed at stays so in a wider band, so that a click at its edge counts.
  const pointed = arrows.filter(({ own }) => own.some((one) => one.name === hovered));
  return (within(3) ?? within(16, pointed) ?? within(10))?.one.name ?? null;
}
function zoom(factor, place = null) {
  const at = scales(), [x, y] = place ?? [at.x(view.x), at.y(view.y)];
  const [dx, dy] = [(x - at.x(view.x)) * at.perX, (at.y(view.y) - y) * at.perY];
  view = { x: view.x + dx * (1 - factor), y: view.y + dy * (1 - factor),
    wide: view.wide * factor, high: view.high * factor };
  drawSection();
}
let drag = null;
Object.assign(id("section"), {
  onwheel(event) {
    event.preventDefault();
    if (view) zoom(Math.exp(Math.sign(event.deltaY) * 0.18), local(event));
  },
  onpointerdown(event) {
    drag = view && { from: local(event), view, moved: false };
    this.setPointerCapture(event.pointerId);
  },
  onpointermove(event) {
    const [x, y] = local(event);
    if (!drag) return view && hover(pointAt([x, y]));
    const at = scales(), [dx, dy] = [x - drag.from[0], y - drag.from[1]];
    drag.moved ||= Math.hypot(dx, dy) > 4;
    const { view: from } = drag;
    if (drag.moved) view = { ...from, x: from.x - dx * at.perX, y: from.y + dy * at.perY };
    drawSection();
  },
  onpointerup(event) {
    append(drag && !drag.moved ? pointAt(local(event)) : null);
    drag = null;
  },
  ondblclick() { view = null; drawSection(); },
  onkeydown(event) {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const [dx, dy] = steps[event.key] ?? [0, 0];
    if (!view || !(dx || dy || "+=-0".includes(event.key))) return;
    event.preventDefault();
    if ("+=-".includes(event.key)) zoom(event.key === "-" ? 1.25 : 0.8);
    else if (event.key === "0") view = null;
    else view = { ...view, x: view.x + 0.2 * dx * view.wide, y: view.y + 0.2 * dy * view.high };
    drawSection();
  },
});
Object.assign(id("graph"), {
  onpointermove: (event) => hover(arrowAt(local(event))),
  onclick: (event) => append(arrowAt(local(event))),
});
for (const name of ["section", "graph"]) id(name).onpointerleave = () => drag || hover(null);
id("strip").onpointerdown = id("strip").onpointermove = (event) => {
  const share = (local(event)[0] - LEFT) / (id("strip").clientWidth - LEFT - RIGHT);
  if (event.buttons) time = Math.max(Math.min(share, 1), 0) * got[showing].duration;
};
id("strip").onkeydown = ({ key }) => {
  time = Math.max(time + ({ ArrowLeft: -0.1, ArrowRight: 0.1 }[key] ?? 0), 0);
};
id("list").onkeydown = (event) => {
  const step = { ArrowDown: 1, ArrowUp: -1 }[event.key], buttons = all("#list button");
  if (!step) return;
  event.preventDefault();
  buttons[buttons.indexOf(document.activeElement) + step]?.focus();
};
onkeydown = (event) => {
  const typing = event.target.matches("textarea, select, input:not([type=range])");
  const held = (event.ctrlKey || event.metaKey) && event.key.toLowerCase();
  if (held === "s") send("save");
  else if (held === "z" && !typing) send(event.shiftKey ? "redo" : "undo");
  else if (held === "y" && !typing) send("redo");
  else if (event.key === "Escape" && state.busy && !id("paper").open) send("cancel");
  else if (event.key === " " && !typing && !event.target.matches("button")) id("play").click();
  else return;
  event.preventDefault();
};
onpointerdown = ({ target }) => { pressed = Boolean(target.closest("button")); };
// The click follows in the same task.
onpointerup = onpointercancel = () => { pressed = false; setTimeout(render); };
const sizes = new ResizeObserver(() => { layGraph(); drawGraph(); drawSection(); });
for (const name of ["section", "graph"]) sizes.observe(id(name));
const fold = (is) => {
  id("fold").classList.toggle("folded", is);
  id("unfold").ariaExpanded = String(!is);
};
fold(true);
id("unfold").onclick = () => fold(!id("fold").classList.contains("folded"));
role("toml").onfocus = () => fold(false);
matchMedia("(prefers-color-scheme: dark)").onchange = recolour;
recolour();
requestAnimationFrame(frame);
// A page that is loaded again keeps its window's name, and so its session; others have their own.
window.name ||= crypto.randomUUID();
connect();
