"use strict";
// The page asks for all figures once a second. Of a thousand sensors only the cards in view are written; pictures are
// asked for where the hub says that there is another one, a few at a time. Texts go into the page as texts.
const POLL_MS = 1000, SOON_MS = 300, GIVE_UP_MS = 4000, PICTURES_AT_ONCE = 4, ORDER_MS = 5000, QUIET_S = 5, PAST_MS = 60000;
const cards = new Map(), seen = new Set(), loading = new Set();
const at = id => document.getElementById(id);
const list = at("cards"), template = at("card");
let heardAt = 0, orderedAt = 0, drawnMs = [], timer = 0, hurried = 0, accent = "";

// What has not changed is not written: the browser would lay it out again.
const written = new WeakMap();
const write = (element, text) => {
  if (written.get(element) === text) return;
  written.set(element, text);
  element.textContent = text;
};
const mark = (element, name) => { if (element.className !== name) element.className = name; };

const UNITS = ["", " k", " M", " G", " T"];
const short = value => {
  let unit = 0;
  while (Math.abs(value) >= 999.5 && unit < UNITS.length - 1) { value /= 1000; unit++; }
  const digits = unit === 0 && Number.isInteger(value) ? 0 : Math.abs(value) >= 99.5 ? 0 : Math.abs(value) >= 9.995 ? 1 : 2;
  return value.toFixed(digits) + UNITS[unit];
};
const size = bytes => { const text = short(bytes); return text + (/[kMGT]$/.test(text) ? "B" : " B"); };
const count = value => value.toLocaleString("en");
const time = s => s < 0.95 ? `${Math.round(s * 1000)} ms` : s < 59.5 ? `${short(s)} s` : s < 3570 ? `${Math.round(s / 60)} min`
  : s < 86400 ? `${Math.floor(s / 3600)} h ${Math.round(s % 3600 / 60)} min` : s < 864000 ? `${Math.floor(s / 86400)} d ${Math.round(s % 86400 / 3600)} h` : `${Math.round(s / 86400)} d`;
const micros = us => Math.abs(us) < 999.5 ? `${Math.round(us)} µs` : Math.abs(us) < 999500 ? `${short(us / 1000)} ms` : `${short(us / 1e6)} s`;
const named = parts => parts.filter(([, value]) => value > 0).map(([name, value]) => `${count(value)} ${name}`).join(", ");

// Of all causes: frames weigh as much as events, which there are more of.
const losses = ({ losses: l }) => l.frames_missing + l.frames_missing_before + l.frames_damaged + l.frames_let_go
  + l.disk_failures + l.disk_damaged_frames + l.events_late + l.events_dropped + l.events_thinned;
const age = row => Math.min(row.frame_age_s ?? Infinity, row.status_age_s ?? Infinity);

const state = row => {
  if (row.at_once > 1) return [`▲ ${row.at_once} sensors with this name`, "state bad"];
  if (!row.is_connected) return ["○ not connected", "state off"];
  const frame = row.frame_age_s;
  if (frame === null) return ["◐ no frames yet", "state quiet"];
  return frame > QUIET_S ? [`◐ quiet for ${time(frame)}`, "state quiet"] : ["● connected", "state on"];
};
const times = ({ window: w, rate }) => {
  if (!w) return "–";
  const of = w.times;
  const kept = of === "exact" ? "exact" : "within_us" in of ? `within ${of.within_us} µs` : "bins" in of ? of.bins === 1 ? "to the window" : `in ${of.bins} bins`
    : `${of.coefficients} coefficients a pixel`;
  const thinned = rate.thinned_per_s > 0 ? `, thinned by ${short(rate.thinned_per_s)}/s` : "";
  return `${kept}, ${w.coder} coder${thinned}`;
};
// The difference between the clocks is taken off; while it is not known, there is no latency.
const latency = ({ latency: l, clock: c, frame_age_s: age }) => {
  if (!c) return [age === null ? "–" : "unknown: its clock has not answered", ""];
  const took = l ? `${micros(Math.max(0, l.p50_us))}, p99 ${micros(Math.max(0, l.p99_us))}, ± ${micros(c.error_us)}` : "–";
  if (!c.is_different) return [took, ""];
  return [`${took}; its clock is ${time(Math.abs(c.ahead_us) / 1e6)} ${c.ahead_us > 0 ? "ahead" : "behind"}`, "warn"];
};

// The last minute of a card's rate, from 0 to its highest.
const trace = ({ parts: { trace: canvas }, past }) => {
  const { width, height } = canvas, scale = devicePixelRatio;
  const to = canvas.getContext("2d"), now = past[past.length - 1][0], most = Math.max(1, ...past.map(([, rate]) => rate));
  to.clearRect(0, 0, width, height);
  to.strokeStyle = to.fillStyle = accent;
  to.lineWidth = 1.5 * scale;
  to.beginPath();
  for (const [when, rate] of past) to.lineTo(width * (1 - (now - when) / PAST_MS), height - scale - (height - 3 * scale) * rate / most);
  to.stroke();
  to.lineTo(width, height);
  to.lineTo(width * (1 - (now - past[0][0]) / PAST_MS), height);
  to.globalAlpha = 0.15;
  to.fill();
  to.globalAlpha = 1;
};

// Nobody asks the browser for a size while texts change: it would lay out the page anew for each card.
const sized = new ResizeObserver(entries => {
  for (const { target, contentRect: { width, height } } of entries) {
    if (width === 0) continue;
    [target.width, target.height] = [width, height].map(side => Math.round(side * devicePixelRatio));
    const card = cards.get(target.closest("li").dataset.name);
    if (card) trace(card);
  }
});

const draw = (card, row) => {
  const { parts } = card;
  const [text, kind] = state(row);
  write(parts.state, text);
  mark(parts.state, kind);
  mark(parts.article, row.is_connected ? "" : "gone");
  const { rate, window: w, losses: l } = row;
  write(parts.events, short(rate.events_per_s));
  write(parts.bytes, size(rate.bytes_per_s));
  write(parts.bits, rate.bits_per_event === null ? "–" : short(rate.bits_per_event));
  const all = row.windows.reduce((sum, each) => sum + each, 0);
  const shares = row.windows.map(each => all > 0 ? 100 * each / all : 0);
  shares.forEach((share, i) => { const width = `${share.toFixed(1)}%`; if (parts.bar[i].style.width !== width) parts.bar[i].style.width = width; });
  ["sparse", "moderate", "dense"].forEach((name, i) => {
    const [part, share] = [parts.mix[i], shares[i]];
    if (part.hidden !== (share === 0)) part.hidden = share === 0;
    write(part, `${name} ${share > 0 && share < 0.5 ? "<1" : Math.round(share)}%`);
  });
  write(parts.window, w ? `${w.regime}, ${w.transform.toUpperCase()}, ${short(rate.windows_per_s)}/s` : "–");
  write(parts.density, w ? `${short(w.density)} events/pixel s` : "–");
  write(parts.times, times(row));
  const [took, how] = latency(row);
  write(parts.latency, took);
  mark(parts.latency, how);
  const frames = named([["missing", l.frames_missing], ["missing from earlier runs", l.frames_missing_before], ["damaged", l.frames_damaged],
    ["dropped by its store", l.frames_let_go], ["not written to disk", l.disk_failures],
    ["damaged on disk", l.disk_damaged_frames], ["unreadable messages", l.malformed]]);
  write(parts.frames, frames || "all here");
  mark(parts.frames, frames ? "bad" : "");
  const lost = named([["late", l.events_late], ["dropped", l.events_dropped], ["thinned", l.events_thinned]]);
  const filtered = l.events_filtered > 0 ? `${count(l.events_filtered)} filtered` : "";
  write(parts.lost, row.status_age_s === null ? "unknown" : [lost, filtered].filter(text => text).join(", ") || "none");
  mark(parts.lost, lost ? "bad" : "");
  write(parts.outages, l.outages > 0 ? `${count(l.outages)}, ${time(l.outages_s)} in all` : "none");
  const budget = row.budget === null ? "none" : `${size(row.budget)}/s`;
  write(parts.budget, row.is_congested ? `${budget}, link congested` : budget);
  mark(parts.budget, row.is_congested ? "warn" : "");
  write(parts.store, row.status_age_s === null ? "unknown" : `${size(row.store_memory_bytes)}, disk ${size(row.store_disk_bytes)}`);
  const heard = age(row);
  write(parts.sensor, [row.columns > 0 ? `${row.columns} × ${row.rows}` : "size unknown", row.up_s === null ? "" : `up ${time(row.up_s)}`,
    row.at_once < 2 && row.at_once_most > 1 ? `${row.at_once_most} sensors had this name at once` : "",
    heard === Infinity ? "never heard" : heard > 1.5 ? `heard ${time(heard)} ago` : ""].filter(text => text).join(", "));
  const isFed = row.is_connected && row.frame_age_s !== null && row.frame_age_s <= QUIET_S;
  write(parts.blank, isFed ? "waiting for a picture" : "no frames, no picture");
  trace(card);
  if (row.columns > 0) {
    const ratio = String(row.columns / row.rows);
    if (card.ratio !== ratio) parts.image.style.setProperty("--ratio", card.ratio = ratio);
  }
};

const watch = new IntersectionObserver(entries => {
  for (const { target, isIntersecting } of entries) {
    const card = cards.get(target.dataset.name);
    if (!card) continue;
    if (!isIntersecting) { seen.delete(card); continue; }
    seen.add(card);
    draw(card, card.row);
    // The hub keeps frames of what is looked at: it hears of it soon, and is soon asked what has come of it.
    if (card.shown === null) hurried = 3;
  }
  if (hurried > 0 && timer !== 0) { clearTimeout(timer); timer = setTimeout(poll, SOON_MS); }
}, { rootMargin: "150px" });

const make = row => {
  const item = template.content.firstElementChild.cloneNode(true);
  const one = what => item.querySelector(what);
  const parts = { article: one("article"), state: one(".state"), image: one("img"), blank: one(".view p"), bar: [...item.querySelectorAll(".bar i")], mix: [...item.querySelectorAll(".mix span")], trace: one("canvas") };
  for (const element of item.querySelectorAll("[data-of]")) parts[element.dataset.of] = element;
  item.dataset.name = row.name;
  one("h2").textContent = row.name;
  parts.image.alt = `Latest events of ${row.name}: ON blue, OFF orange`;
  parts.trace.setAttribute("aria-label", `Events / s of ${row.name} over the last minute`);
  const card = { item, parts, row, shown: null, past: [[performance.now(), row.rate.events_per_s]] };
  cards.set(row.name, card);
  draw(card, row);
  watch.observe(item);
  sized.observe(parts.trace);
  return card;
};

// Another picture, once it is whole; the one before stays until then.
const fetchPicture = card => {
  const number = card.row.picture;
  loading.add(card);
  const { image, blank } = card.parts;
  const done = isShown => {
    loading.delete(card);
    card.shown = number;
    if (isShown) { image.hidden = false; blank.hidden = true; }
    pictures();
  };
  image.onload = () => done(true);
  image.onerror = () => done(false);
  image.src = `/picture/${card.row.name}.png?${number}.${card.row.run}`;
};
const pictures = () => {
  for (const card of seen) {
    if (loading.size >= PICTURES_AT_ONCE) return;
    const { row, shown } = card;
    if (!loading.has(card) && !card.item.hidden && row.picture !== null && row.picture !== shown) fetchPicture(card);
  }
};

const ORDERS = {
  name: () => 0,
  rate: (a, b) => b.row.rate.events_per_s - a.row.rate.events_per_s,
  losses: (a, b) => losses(b.row) - losses(a.row),
};
const arrange = () => {
  const by = ORDERS[at("order").value], wanted = at("filter").value.trim().toLowerCase();
  const sorted = [...cards.values()].sort((a, b) => by(a, b) || (a.row.name < b.row.name ? -1 : 1));
  let place = list.firstElementChild, shown = 0;
  for (const card of sorted) {
    const isHidden = !card.row.name.toLowerCase().includes(wanted);
    if (card.item.hidden !== isHidden) card.item.hidden = isHidden;
    shown += isHidden ? 0 : 1;
    if (card.item === place) place = place.nextElementSibling;
    else list.insertBefore(card.item, place);
  }
  write(at("count"), shown === cards.size ? "" : `${count(shown)} of ${count(cards.size)} shown`);
  write(at("none"), cards.size === 0 ? "No sensor has been heard of yet." : `No name contains “${wanted}”.`);
  at("none").hidden = shown > 0;
  orderedAt = performance.now();
};

const update = board => {
  const started = performance.now();
  write(at("hub"), board.hub);
  const title = `EECVS hub ${board.hub}`;
  if (document.title !== title) document.title = title;
  const rows = board.sensors;
  const sum = of => rows.reduce((all, row) => all + of(row), 0);
  write(at("connected"), count(board.connected));
  write(at("known"), board.refused > 0 ? `of ${count(rows.length)} known; no room for more` : `of ${count(rows.length)} known`);
  const [events, bytes] = [sum(row => row.rate.events_per_s), sum(row => row.rate.bytes_per_s)];
  write(at("events"), short(events));
  write(at("windows"), `${short(sum(row => row.rate.windows_per_s))} windows / s`);
  write(at("bytes"), size(bytes));
  write(at("bits"), events > 0 ? `${short(8 * bytes / events)} bits / event` : "");
  const missing = sum(row => row.losses.frames_missing + row.losses.frames_missing_before);
  write(at("missing"), count(missing));
  mark(at("missing"), missing > 0 ? "bad" : "");
  const damaged = sum(row => row.losses.frames_damaged), malformed = board.malformed + sum(row => row.losses.malformed);
  write(at("damaged"), named([["damaged", damaged], ["unreadable", malformed]]) || "none damaged");
  write(at("routers"), count(board.routers));
  write(at("receivers"), `receivers linked: ${count(board.receivers)}`);
  let isNew = cards.size === 0;
  const names = new Set();
  for (const row of rows) {
    names.add(row.name);
    const card = cards.get(row.name);
    if (!card) { make(row); isNew = true; continue; }
    card.row = row;
    card.past.push([started, row.rate.events_per_s]);
    while (started - card.past[0][0] > PAST_MS) card.past.shift();
    if (seen.has(card)) draw(card, row);
  }
  // After the hub was started anew, it may know fewer.
  for (const [name, card] of cards) if (!names.has(name)) { watch.unobserve(card.item); sized.unobserve(card.parts.trace); seen.delete(card); card.item.remove(); cards.delete(name); isNew = true; }
  // Cards that change their places all the time cannot be read.
  if (isNew || at("order").value !== "name" && started - orderedAt > ORDER_MS) arrange();
  pictures();
  drawnMs.push(performance.now() - started);
  if (drawnMs.length > 60) drawnMs.shift();
};

const said = (text, isLost) => { write(at("said"), text); mark(at("said"), isLost ? "lost" : ""); };
const poll = async () => {
  timer = 0;
  const started = performance.now();
  const see = [...seen].filter(card => !card.item.hidden).slice(0, 200).map(card => `see=${card.row.name}`).join("&");
  try {
    const answer = await fetch(`/sensors.json?${see}`, { cache: "no-store", signal: AbortSignal.timeout(GIVE_UP_MS) });
    if (!answer.ok) throw new Error(answer.statusText);
    const board = await answer.json();
    update(board);
    heardAt = performance.now();
    said("● live", false);
  } catch {
    const since = heardAt > 0 ? ` for ${time((performance.now() - heardAt) / 1000)}: the figures shown are older` : "";
    said(`The hub has not answered${since}`, true);
  }
  const pause = hurried > 0 ? SOON_MS : POLL_MS;
  if (hurried > 0) hurried--;
  timer = setTimeout(poll, Math.max(100, pause - (performance.now() - started)));
};

at("filter").addEventListener("input", arrange);
at("order").addEventListener("change", arrange);
at("controls").addEventListener("submit", event => event.preventDefault());
const scheme = matchMedia("(prefers-color-scheme: dark)");
const colours = () => { accent = getComputedStyle(document.documentElement).getPropertyValue("--accent"); };
scheme.addEventListener("change", colours);
colours();
poll();
