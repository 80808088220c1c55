// The panel: draws what the server tells, and asks it for what is clicked. It keeps no state of the robot's own.
"use strict";
(() => {
  const $ = (id) => document.getElementById(id);
  const SIGNS = {idle: "\u25CB", approach: "\u2192", hold: "\u25A0", track: "\u25B6", crossing: "\u2715", safe_stop: "\u25B2", fault: "\u26A0\uFE0E"};
  const MOVING = ["approach", "track", "crossing"], LIMP = ["safe_stop", "fault"];
  const SPAN = 8, SPANS = [0.8, 2, 4, 8, 20, 40, 80], SAMPLES = 1200, TRAIL = 60;  // s of a strip, on the clock and, where the simulation has a pace of its own, by it; samples that are kept, whatever the rate; places of the trail
  const BORDER = 0.012;  // m around the workspace
  const READING = 100;  // ms between two changes of what is read: a page that lays itself out less often hears a click sooner
  const ARROW = 0.03;  // m, of t_s
  const MENDS = {enable: "Torque on", reset: "Reset", activate: "Activate the controller"};
  const store = {get: (key) => { try { return sessionStorage.getItem(key); } catch { return null; } },
                 set: (key, value) => { try { sessionStorage.setItem(key, value); } catch { /* a page without storage */ } }};

  let setup = null, state = null, status = null, path = {path: [], crossings: []}, plan = null, planned = "";
  let socket = null, number = 0, tries = 0, driving = false, dirty = true, filled = false, color = {}, waits = null, lastTime = NaN;
  const answers = new Map(), trail = [];
  const ring = {at: 0, count: 0, time: new Float64Array(SAMPLES), s: new Float64Array(SAMPLES), error: new Float64Array(SAMPLES),
                torque: [new Float64Array(SAMPLES), new Float64Array(SAMPLES)], limit: new Float64Array(SAMPLES)};

  // ---- words
  const known = (value) => typeof value === "number" && Number.isFinite(value);
  const fixed = (value, digits, unit = "") => known(value) ? value.toFixed(digits) + unit : "\u2013";
  function signed(value, digits) {
    if (!known(value)) return "\u2013";
    const text = Math.abs(value).toFixed(digits);
    return (Number(text) === 0 ? "" : value < 0 ? "\u2212" : "+") + text;
  }
  function put(node, text) { if (node.textContent !== text) node.textContent = text; }
  function notice(text, bad = true) {
    const box = $("notice");
    box.hidden = !text;
    box.classList.toggle("bad", bad);
    put(box, text || "");
  }
  function tiles(list, rows) {
    if (list.children.length !== rows.length) list.replaceChildren(...rows.map(() => {
      const row = document.createElement("div");
      row.append(document.createElement("dt"), document.createElement("dd"));
      return row;
    }));
    rows.forEach(([name, text], index) => { put(list.children[index].children[0], name); put(list.children[index].children[1], text); });
  }

  // ---- connection
  function connect() {
    const query = new URLSearchParams({token: new URLSearchParams(location.search).get("token") || "", drive: store.get("drive") ?? "1"});
    const address = new URL(`stream?${query}`, location.href);
    address.protocol = address.protocol.replace("http", "ws");
    let opened = false;
    socket = new WebSocket(address);
    socket.onopen = () => { opened = true; tries = 0; notice(""); link("connected", false); };
    socket.onmessage = (event) => hear(JSON.parse(event.data));
    socket.onclose = (event) => {
      for (const answer of answers.values()) answer({ok: false, text: "the connection was lost before the panel answered"});
      answers.clear();
      driving = false;
      tries += 1;
      link(`no connection, attempt ${tries}`, true);
      if (opened || tries === 1 || event.reason) notice("The connection to the panel is lost. The robot stays to the controller's own rules;"
        + " in a terminal dextar stop stops it. This page tries again by itself." + (event.reason ? ` (${event.reason})` : ""));
      if (!opened) whyNot(query);
      setTimeout(connect, Math.min(3000, 250 * 2 ** Math.min(tries, 4)));
      drivers({driver: "nobody"});
      dirty = true;
    };
  }
  async function whyNot(query) {  // a browser does not tell why a stream was refused
    try {
      const answer = await fetch(`why?${query}`, {cache: "no-store"});
      const text = (await answer.text()).trim();
      if (text) notice(`The panel refuses: ${text}`);
    } catch { /* nobody answers, which is said already */ }
  }
  function link(text, bad) { put($("link"), text); $("link").classList.toggle("bad", bad); }
  function ask(name, more = {}) {
    return new Promise((resolve) => {
      if (!socket || socket.readyState !== WebSocket.OPEN) {
        resolve({ok: false, text: "there is no connection to the panel: nothing was asked"});
        return;
      }
      number += 1;
      answers.set(number, resolve);
      socket.send(JSON.stringify({...more, ask: name, number}));
    });
  }
  async function order(name, more) {
    const answer = await ask(name, more);
    notice(answer.ok ? "" : sentence(answer.text));
    if (answer.ok && answer.text) say(sentence(answer.text));
    return answer;
  }
  const sentence = (text) => text ? text[0].toUpperCase() + text.slice(1) + (/[.!?]$/.test(text) ? "" : ".") : "";
  async function stop() {
    const answer = await ask("stop");
    if (answer.ok) say("Stop: asked for.");
    else notice(`STOP did not reach the robot: ${answer.text}. In a terminal: dextar stop.`);
  }

  // ---- what the server tells
  function hear(message) {
    dirty = true;
    if (message.kind === "state") take(message);
    else if (message.kind === "status") { status = message; tell(); }
    else if (message.kind === "path") path = message;
    else if (message.kind === "setup") begin(message);
    else if (message.kind === "driver") drivers(message);
    else if (message.kind === "answer") {
      const answer = answers.get(message.number);
      answers.delete(message.number);
      if (answer) answer(message); else if (!message.ok) notice(sentence(message.text));
    }
  }
  function take(message) {
    state = message;
    if (message.time < lastTime - 0.5) { ring.count = ring.at = 0; trail.length = 0; }  // it began anew
    if (message.time !== lastTime) {
      const at = ring.at;
      ring.time[at] = message.time;
      ring.s[at] = message.s ?? NaN;
      ring.error[at] = message.error === null ? NaN : 1e3 * message.error;
      ring.torque.forEach((one, index) => { one[at] = message.torque[index] ?? NaN; });
      ring.limit[at] = message.limit || NaN;  // 0: there is no torque
      ring.at = (at + 1) % SAMPLES;
      ring.count = Math.min(ring.count + 1, SAMPLES);
      trail.push(message.x);
      if (trail.length > TRAIL) trail.shift();
    }
    lastTime = message.time;
  }
  function drivers(message) {
    if (message.driver === "you" && !driving) replan();
    driving = message.driver === "you";
    store.set("drive", driving || message.driver === "nobody" && store.get("drive") !== "0" ? "1" : "0");
    const others = (message.viewers || 1) - 1, more = others > 0 ? ` ${others} other page${others > 1 ? "s" : ""} open.` : "";
    put($("driver").firstElementChild, {you: "This page drives.", another: "Another page drives; this one watches.",
                                        nobody: "Nobody drives."}[message.driver] + more);
    $("take").hidden = driving;
    enable();
  }
  function begin(message) {
    setup = message;
    put($("robot"), setup.namespace === "/" ? setup.robot : `${setup.robot} in ${setup.namespace}`);
    document.title = `dextar panel: ${$("robot").textContent}`;
    const controller = Object.fromEntries(setup.specs.controller.map((spec) => [spec.name, spec]));
    for (const name of ["law", "estimator"]) options($(`law-${name}`), controller[name].choices);
    options($("node"), Object.keys(setup.specs));
    fields();
    legend();
    size();
  }
  function options(select, names) {
    const before = select.value;
    select.replaceChildren(...names.map((name) => new Option(name.replaceAll("_", " "), name)));
    if (names.includes(before)) select.value = before;
  }

  function tell() {
    const told = status.controller;
    phases();
    const why = $("why"), button = why.lastElementChild;
    why.hidden = !status.why;
    put(why.firstElementChild, status.why);
    button.hidden = !MENDS[status.action];
    button.dataset.action = status.action;
    put(button, MENDS[status.action] || "");
    const pace = Number(status.plant.real_time_factor), latency = Number(told.latency_p99_us);
    tiles($("rates"), [
      ["States", fixed(Number(told.rate), 0, " Hz")], ["Jitter", fixed(Number(told.jitter_us), 0, " \u00B5s")],
      ["Real-time factor", fixed(pace, 2)], ["Missed states", told.missed_states ?? "\u2013"],
      ["Steps without their command", status.plant.late_ticks ?? "\u2013"], ["Stalls", told.stalls ?? "\u2013"],
      ["Latency p99", fixed(latency, 0, " \u00B5s")],
      ["At a torque limit", fixed(100 * told.saturated_share, 1, " %")],
    ]);
    const names = Object.entries(status.nodes);
    rows($("nodes"), names.length ? names.map(([name, node]) => [`${name}: ${node.message}`, node.level > 0]) : [["no node is heard of", true]]);
    margins();
    recorder();
    said();
    const running = status.progress, progress = $("progress");
    if (!running && !progress.hidden) replan();  // it stands somewhere else now, perhaps
    progress.hidden = !running;
    if (running) { progress.firstElementChild.value = running[1]; put(progress.lastElementChild, running[0]); }
    if (status.complaint) notice(sentence(status.complaint));
    if (!filled && status.values.trajectory_server) fill(status.values.trajectory_server);
    current();
    enable();
  }
  function phases() {  // by the newest sample; by what the controller tells of itself where there is none
    if (!status) return;
    const told = status.controller, sampled = told.lifecycle === "active" && state && !state.stale;
    const phase = sampled ? state.phase : (told.phase || "").toLowerCase(), silent = told.lifecycle === "active" ? "no answer" : told.lifecycle;
    put($("sign"), SIGNS[phase] || "?");
    put($("phase-name"), phase ? phase.replaceAll("_", " ").toUpperCase() : silent || (status.listening ? "listening" : "no controller"));
    $("phase").classList.toggle("bad", LIMP.includes(phase) || !phase && !status.listening);
    $("phase").classList.toggle("moving", MOVING.includes(phase));
  }
  function rows(list, entries) {
    const key = JSON.stringify(entries);
    if (list.dataset.shown === key) return;
    list.dataset.shown = key;
    list.replaceChildren(...entries.map(([text, bad]) => {
      const item = document.createElement("li");
      item.textContent = text;
      item.classList.toggle("bad", Boolean(bad));
      return item;
    }));
  }
  function margins() {
    const body = $("margins").tBodies[0];
    while (body.rows.length > status.margins.length) body.deleteRow(-1);
    status.margins.forEach((one, index) => {
      let row = body.rows[index];
      if (!row) {
        row = body.insertRow();
        for (let k = 0; k < 4; k += 1) row.insertCell();
        const bar = document.createElement("span");
        bar.className = "bar";
        bar.append(document.createElement("i"));
        row.cells[3].append(bar, document.createElement("span"));
      }
      [one.name.replaceAll("_", " "), one.value, `${one.limit} ${one.unit}`.trim()].forEach((text, k) => put(row.cells[k], text));
      row.cells[3].firstChild.firstChild.style.width = `${100 * one.used}%`;
      put(row.cells[3].lastChild, `${(100 * one.used).toFixed(0)} %${one.used > 0.8 ? " !" : ""}`);
      row.classList.toggle("near", one.used > 0.8);
    });
  }
  function recorder() {
    const told = status.recorder, on = told.recording === "True";
    put($("recorded"), !("recording" in told) ? "No recorder is heard of: nothing is recorded."
      : on ? `Recording to ${told.bag}, ${(told.bytes / 1e6).toFixed(1)} MB, ${told.lost} lost.`
        : `Not recording.${status.bag ? ` The last bag is ${status.bag}.` : ""}`);
    $("record-on").disabled = !driving || !("recording" in told) || on;
    $("record-off").disabled = !driving || !on;
    $("report").disabled = !driving || !status.bag;
    $("report-link").hidden = !status.reported;
    const token = new URLSearchParams(location.search).get("token");
    $("report-link").firstElementChild.href = `report${token ? `?token=${encodeURIComponent(token)}` : ""}`;
  }
  const mine = [];
  function say(text) { mine.push(text); if (mine.length > 20) mine.shift(); said(); }
  function said() {
    const list = $("lines"), end = list.scrollHeight - list.scrollTop - list.clientHeight < 30;
    rows(list, [...(status ? status.lines.map(([, text]) => [text, false]) : []), ...mine.map((text) => [text, false])]);
    if (end) list.scrollTop = list.scrollHeight;
  }
  function enable() {
    const told = status ? status.controller : {}, phase = (told.phase || "").toLowerCase(), active = told.lifecycle === "active";
    $("go").disabled = !driving || !plan || status === null || status.progress !== null
      || !(phase === "hold" || phase === "idle" && told.enabling === "waiting");
    $("on").disabled = !driving || !active || phase !== "idle";
    $("off").disabled = !driving || !active || phase === "idle" || LIMP.includes(phase);
    $("reset").disabled = !driving || !LIMP.includes(phase);
    $("why").lastElementChild.disabled = !driving;
    for (const one of $("law").elements) one.disabled = !driving || MOVING.includes(phase);
    for (const one of $("parameters").querySelectorAll("input, select")) one.disabled = !driving;
  }

  // ---- task and plan
  const field = (id) => $(id).valueAsNumber;
  function fill(values) {
    filled = true;
    [["start", values["task.start"]], ["goal", values["task.goal"]], ["point", values["task.point"]]].forEach(([name, x]) => place(name, x));
    $("duration").value = values["task.duration"];
    $("repeat").value = values["task.repeat"];
    const tour = values["task.tour"], point = values["task.point"];
    $("kind").value = tour ? "tour" : point && point.length ? "point" : "trip";
    if (tour) $("count").value = tour;
    kind();
  }
  function place(name, x) {
    if (x && x.length === 2) ["x", "y"].forEach((axis, k) => { $(`${name}-${axis}`).value = Number(x[k].toFixed(4)); });
  }
  const spot = (name) => [field(`${name}-x`), field(`${name}-y`)];
  function kind() {
    for (const row of document.querySelectorAll("[data-for]")) row.hidden = !row.dataset.for.split(" ").includes($("kind").value);
    replan();
  }
  function task() {
    const asked = {kind: $("kind").value, start: spot("start"), duration: field("duration"), repeat: field("repeat")};
    if (asked.kind === "trip") asked.goal = spot("goal");
    if (asked.kind === "point") asked.point = spot("point");
    if (asked.kind === "tour") asked.count = field("count");
    const numbers = Object.values(asked).flat().filter((value) => typeof value !== "string");
    return numbers.every(Number.isFinite) ? asked : null;
  }
  function replan() {
    plan = null;
    $("instead").hidden = true;
    enable();
    clearTimeout(waits);
    waits = setTimeout(propose, 250);
  }
  async function propose() {
    const asked = task();
    if (!asked) { planWords("Fill in the numbers, or click in the workspace.", false); return; }
    if (!driving) { planWords("Plans are made for the page that drives.", false); return; }
    const key = JSON.stringify(asked);
    planned = key;
    planWords("Planning \u2026", false);
    const answer = await ask("plan", asked);
    if (planned !== key || answer.given_up) return;
    plan = answer.ok ? answer.plan : null;
    if (answer.ok) planWords(`Peak torque ${fixed(plan.peak, 4)} of ${fixed(plan.limit, 3)} N m, ${fixed(plan.duration, 3)} s,`
      + ` ${plan.crossings.length} crossing${plan.crossings.length === 1 ? "" : "s"}.`, false);
    else planWords(sentence(answer.text), true);
    const [name, value] = Object.entries(answer.instead || {})[0] || [];
    $("instead").hidden = !name;
    if (name) {
      const button = $("instead").firstElementChild;
      put(button, name === "duration" ? `Take ${(Math.ceil(1e4 * value) / 1e4).toFixed(4)} s each way`
        : `Take the point (${value.map((one) => one.toFixed(4)).join(", ")})`);
      button.onclick = () => {
        if (name === "duration") $("duration").value = Math.ceil(1e4 * value) / 1e4;
        else { $("kind").value = "point"; place("point", value); kind(); }
        replan();
      };
    }
    $("plan").hidden = !plan;
    dirty = true;
    size();
    enable();
  }
  function planWords(text, bad) { put($("plan-words"), text); $("plan-words").classList.toggle("bad", bad); }
  async function go(event) {
    event.preventDefault();
    const asked = task();
    if ($("go").disabled || !asked) return;
    $("go").disabled = true;
    await order("go", asked);
  }

  // ---- parameters
  function fields() {
    const node = $("node").value, words = $("find").value.trim().toLowerCase();
    const specs = setup.specs[node].filter((one) => one.live && !["run.name", "run.notes"].includes(one.name)
      && `${one.name} ${one.description}`.toLowerCase().includes(words));
    $("parameters").replaceChildren(...specs.map((spec) => {
      const row = document.createElement("label"), name = document.createElement("b"), about = document.createElement("small");
      row.className = "parameter";
      row.dataset.name = spec.name;
      name.textContent = spec.name;
      const range = !spec.bounds ? "" : spec.bounds[1] === null ? `at least ${spec.bounds[0]}` : spec.bounds.join(" to ");
      const unit = spec.unit && spec.unit !== "1" ? spec.unit : "";
      about.textContent = `${spec.description} ${[range, unit].filter(Boolean).join(" ")}${range || unit ? ", " : ""}default ${shown(spec.default)}`;
      const words = spec.choices.length ? spec.choices : typeof spec.default === "boolean" ? ["true", "false"] : null;
      const input = words ? document.createElement("select") : document.createElement("input");
      if (words) options(input, words); else input.type = "text";
      input.addEventListener("change", () => set(node, spec, input));
      row.append(name, input, about);
      return row;
    }));
    current();
    enable();
  }
  const shown = (value) => Array.isArray(value) ? `[${value.join(", ")}]` : value === "" ? "empty" : String(value);
  const typed = (value) => Array.isArray(value) ? value.join(", ") : String(value ?? "");
  function current() {
    if (!setup || !status) return;
    const node = $("node").value, values = status.values[node] || {};
    const specs = Object.fromEntries(setup.specs[node].map((spec) => [spec.name, spec]));
    for (const row of $("parameters").children) {
      const input = row.children[1], value = values[row.dataset.name];
      if (document.activeElement !== input) { if (value !== undefined) input.value = typed(value); else if (input.type === "text") input.value = ""; }
      row.classList.toggle("changed", value !== undefined && typed(value) !== typed(specs[row.dataset.name].default));
    }
    for (const name of ["law", "estimator"]) {
      const select = $(`law-${name}`), now = status.controller[name];
      if (now && select.dataset.now !== now) {
        if (![...select.options].some((one) => one.value === now)) select.add(new Option(now, now));
        select.dataset.now = now;
        select.value = now;
      }
    }
  }
  async function set(node, spec, input) {
    const text = input.value.trim(), list = Array.isArray(spec.default);
    const numbers = text.split(/[\s,]+/).filter(Boolean).map(Number);
    const value = typeof spec.default === "boolean" ? text === "true" : list ? numbers : typeof spec.default === "number" ? Number(text || "?") : text;
    if ((list ? numbers : [value]).some((one) => Number.isNaN(one))) { notice(`'${text}' is no number: ${spec.name} stays as it is.`); current(); return; }
    await order("set", {node, values: {[spec.name]: value}});
    input.blur();
    current();
    if (node === "trajectory_server") { filled = false; }
  }

  // ---- drawing
  const style = (key) => setup.lines[key];
  function pen(context, line, scale = 1) {
    context.strokeStyle = color[line.color];
    context.lineWidth = line.width * scale;
    context.setLineDash(line.dash);
    context.lineCap = line.dash.length ? "butt" : "round";
    context.lineJoin = "round";
  }
  function strand(context, points) {
    context.beginPath();
    let on = false;
    for (const [x, y] of points) {
      if (!known(x) || !known(y)) { on = false; continue; }
      if (on) context.lineTo(x, y); else context.moveTo(x, y);
      on = true;
    }
    context.stroke();
  }
  function blank(canvas) {
    const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    context.font = `12px ${getComputedStyle(document.body).fontFamily}`;
    return [context, width, height];
  }
  function frame(width, height) {  // of the plane: m to px and back
    const [low, high] = [setup.low, setup.high].map((corner, end) => corner.map((value) => value + (end ? BORDER : -BORDER)));
    const scale = Math.min(width / (high[0] - low[0]), height / (high[1] - low[1]));
    const left = 0.5 * (width - scale * (high[0] - low[0])), top = 0.5 * (height - scale * (high[1] - low[1]));
    return {scale, to: ([x, y]) => [left + scale * (x - low[0]), top + scale * (high[1] - y)],
            back: (x, y) => [low[0] + (x - left) / scale, high[1] - (y - top) / scale]};
  }
  function plane() {
    const [context, width, height] = blank($("plane"));
    const {scale, to} = frame(width, height), all = (points) => points.map((x) => to(x.map((one) => one ?? NaN)));
    for (const arc of setup.arcs) { pen(context, style(`${arc.family}0`)); strand(context, all(arc.x)); }
    pen(context, {color: "mid", dash: [], width: 1});
    strand(context, all(path.path));
    if (plan) { pen(context, style("planned0")); strand(context, all(plan.path)); }
    for (const x of plan ? plan.crossings.map((one) => one.x) : path.crossings) square(context, to(x));
    letter(context, "A", to(spot("start")), $("kind").value !== "point");
    letter(context, "B", to(spot("goal")), $("kind").value === "trip");
    letter(context, "P", to(spot("point")), $("kind").value === "point");
    if (state) robot(context, to, all);
    const bar = to([setup.low[0], setup.low[1]]);
    pen(context, {color: "soft", dash: [], width: 2});
    strand(context, [bar, [bar[0] + 0.05 * scale, bar[1]]]);
    context.fillStyle = color.soft;
    context.fillText("50 mm", bar[0], bar[1] - 5);
    if (!state || state.stale) {
      context.fillStyle = color.bad;
      context.fillText(state ? "no joint states: this is the last that was seen" : "no joint states yet", 8, 16);
    }
  }
  function robot(context, to, all) {
    const faint = state.stale ? 0.4 : 1;
    context.globalAlpha = faint;
    pen(context, style("target0"));
    strand(context, all(trail));
    pen(context, {...style("linkage0"), color: "mid", width: 6});
    strand(context, all(state.links));
    context.fillStyle = color.paper;
    pen(context, {color: "ink", dash: [], width: 1.5});
    state.links.forEach((x, index) => { if (x.every(known)) disc(context, to(x), index === 0 || index === state.links.length - 1 ? 7 : 5); });
    const [x, y] = to(state.x.map((one) => one ?? NaN));
    if (state.t_s.every(known) && known(state.s) && known(x)) {
      context.globalAlpha = faint * Math.max(0.2, 1 - 2 * Math.abs(state.s));
      pen(context, style("t_s0"));
      const tip = to([state.x[0] + ARROW * state.t_s[0], state.x[1] + ARROW * state.t_s[1]]);
      arrow(context, [x, y], tip);
      context.fillStyle = color.bad;
      context.fillText("t", tip[0] + 6, tip[1] - 2);
      context.fillText("s", tip[0] + 11, tip[1] + 2);
      context.globalAlpha = faint;
    }
    context.fillStyle = color.ink;
    pen(context, {color: "ink", dash: [], width: 1.5});
    if (known(x)) disc(context, [x, y], 5);
    if (state.reference.every(known)) {
      const [u, v] = to(state.reference);
      pen(context, {color: "accent", dash: [], width: 2});
      strand(context, [[u - 9, v], [u + 9, v]]);
      strand(context, [[u, v - 9], [u, v + 9]]);
    }
    context.globalAlpha = 1;
  }
  function disc(context, [x, y], radius) { context.beginPath(); context.arc(x, y, radius, 0, 7); context.fill(); context.stroke(); }
  function square(context, [x, y]) {
    context.fillStyle = color.paper;
    pen(context, {color: "bad", dash: [], width: 1.5});
    context.beginPath();
    context.rect(x - 4, y - 4, 8, 8);
    context.fill();
    context.stroke();
  }
  function arrow(context, from, tip) {
    const angle = Math.atan2(tip[1] - from[1], tip[0] - from[0]);
    const [one, other] = [-2.6, 2.6].map((turn) => [tip[0] + 10 * Math.cos(angle + turn), tip[1] + 10 * Math.sin(angle + turn)]);
    strand(context, [from, tip]);
    strand(context, [one, tip, other]);
  }
  function letter(context, text, [x, y], wanted) {
    if (!wanted || !known(x) || !known(y)) return;
    context.fillStyle = color.paper;
    pen(context, {color: "accent", dash: [], width: 2});
    disc(context, [x, y], 9);
    context.fillStyle = color.accent;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillText(text, x, y + 0.5);
    context.textAlign = "start";
    context.textBaseline = "alphabetic";
  }
  function axes(context, width, height, low, high, digits) {
    const left = 46, right = width - 6, top = 8, bottom = height - 18;
    const y = (value) => bottom - (bottom - top) * (value - low) / (high - low);
    context.fillStyle = color.soft;
    context.textAlign = "right";
    for (const value of [low, 0.5 * (low + high), high]) {
      pen(context, {color: "line", dash: [], width: 1});
      strand(context, [[left, y(value)], [right, y(value)]]);
      context.fillText(value.toFixed(digits).replace("-", "\u2212"), left - 5, y(value) + 4);
    }
    context.textAlign = "start";
    return {left, right, top, bottom, y};
  }
  function span() {  // s by the states' stamps
    const pace = Number(status?.plant.real_time_factor);
    return pace > 0 ? SPANS.find((one) => one >= 0.7 * SPAN * pace) || SPANS.at(-1) : SPAN;
  }
  function strip(id, low, high, digits, curves) {
    const [context, width, height] = blank($(id)), {left, right, top, bottom, y} = axes(context, width, height, low, high, digits);
    const end = ring.count ? ring.time[(ring.at + SAMPLES - 1) % SAMPLES] : 0, seconds = span();
    const x = (time) => right - (right - left) * (end - time) / seconds;
    context.fillStyle = color.soft;
    context.fillText(`${seconds} s ago`, left, height - 4);
    context.textAlign = "right";
    context.fillText("now", right, height - 4);
    context.textAlign = "start";
    context.save();
    context.beginPath();
    context.rect(left, top - 3, right - left, bottom - top + 6);
    context.clip();
    for (const [numbers, line] of curves) {
      const points = [];
      for (let k = ring.count; k > 0; k -= 1) {
        const at = (ring.at + SAMPLES - k) % SAMPLES;
        if (ring.time[at] < end - 1.2 * seconds) continue;
        points.push([x(ring.time[at]), typeof numbers === "number" ? y(numbers) : y(numbers[at])]);
      }
      pen(context, line);
      strand(context, points);
    }
    context.restore();
  }
  function top(numbers, least) {  // of an axis: the next of 1, 2, 5 above what is seen
    let most = least;
    for (let k = 0; k < ring.count; k += 1) if (Math.abs(numbers[k]) > most) most = Math.abs(numbers[k]);
    const power = 10 ** Math.floor(Math.log10(most));
    return [1, 2, 5, 10].map((step) => step * power).find((step) => step >= most * 0.999);
  }
  function strips() {
    strip("strip-s", -1, 1, 0, [[0, style("limit0")], [ring.s, style("commanded0")]]);
    const limit = ring.limit, low = ring.limit.map((value) => -value), most = Math.max(...ring.torque.map((one) => top(one, 0.05)));
    strip("strip-torque", -most, most, most < 0.1 ? 2 : 1, [[limit, style("limit0")], [low, style("limit0")],
                                                          [ring.torque[0], style("commanded0")], [ring.torque[1], style("commanded1")]]);
    const error = top(ring.error, 0.01);
    strip("strip-error", 0, error, error < 0.1 ? 3 : error < 1 ? 2 : 1, [[ring.error, style("commanded0")]]);
  }
  function preview() {
    if (!plan) return;
    const [context, width, height] = blank($("plan")), most = 1.1 * plan.limit;
    const {left, right, top: up, bottom, y} = axes(context, width, height, -most, most, 2), x = (time) => left + (right - left) * time / plan.duration;
    for (const one of plan.crossings) { pen(context, {color: "mid", dash: [2, 3], width: 1}); strand(context, [[x(one.time), up], [x(one.time), bottom]]); }
    for (const side of [1, -1]) { pen(context, style("limit0")); strand(context, [[left, y(side * plan.limit)], [right, y(side * plan.limit)]]); }
    [0, 1].forEach((joint) => { pen(context, style(`commanded${joint}`)); strand(context, plan.time.map((time, k) => [x(time), y(plan.torque[k][joint] ?? NaN)])); });
    context.fillStyle = color.soft;
    context.fillText("0 s", left, height - 4);
    context.textAlign = "right";
    context.fillText(`${plan.duration.toFixed(2)} s; torque (N m), crossings dotted`, right, height - 4);
    context.textAlign = "start";
  }
  function numbers() {
    const verdicts = (status ? status.controller.verdicts || "" : "").split(" ").filter(Boolean), begun = Number(status ? status.controller.begun : 0);
    tiles($("now"), [
      ["s", signed(state?.s, 3)], ["Criterion residual", known(state?.residual) ? `${signed(state.residual, 4)} N` : "\u2013"],
      ["Sure of the side", known(state?.confidence) ? `${(100 * state.confidence).toFixed(1)} % of s ${state.mode < 0 ? "<" : ">"} 0` : "\u2013"],
      ["Tracking error", known(state?.error) ? `${(1e3 * state.error).toFixed(3)} mm` : "\u2013"],
      ["Torque q11, q21", state ? `${signed(state.torque[0], 3)}, ${signed(state.torque[1], 3)} N m` : "\u2013"],
      ["Crossings", verdicts.length ? `${begun} of ${verdicts.length}${found(verdicts.slice(0, begun))}` : "none planned"],
    ]);
  }
  function found(verdicts) {  // each verdict, or how many of each where they are many
    const counts = new Map();
    for (const one of verdicts) counts.set(one, (counts.get(one) || 0) + 1);
    const words = verdicts.length > 4 ? [...counts].map(([one, count]) => `${count} ${one}`) : verdicts;
    return words.length ? `: ${words.join(", ")}` : "";
  }
  function key(name) {
    const line = style(name), dash = line.dash.length ? ` stroke-dasharray="${line.dash.join(" ")}"` : "";
    return `<svg class="key" aria-hidden="true"><line x1="1" x2="29" y1="5" y2="5" stroke="var(--${line.color})" stroke-width="${Math.min(line.width, 5)}"${dash}/></svg>`;
  }
  function legend() {
    const words = {stretched0: "locus, stretched", folded0: "locus, folded", planned0: "plan", t_s0: "<i>t</i><sub>s</sub>, stronger near the locus"};
    $("legend").innerHTML = Object.entries(words).map(([name, text]) => `<li>${key(name)} ${text}</li>`).join("")
      + "<li>+ reference</li><li>\u25CF end effector</li><li>\u25A1 crossing</li>";
    for (const one of document.querySelectorAll("[data-key]")) one.innerHTML = key(one.dataset.key);
  }
  function size() { dirty = true; }
  function palette() {
    const styles = getComputedStyle(document.documentElement);
    for (const name of ["paper", "wash", "ink", "soft", "line", "mid", "band", "link", "accent", "bad", "good"]) color[name] = styles.getPropertyValue(`--${name}`).trim();
    dirty = true;
  }
  let read = 0;
  function draw(now) {
    if (dirty && setup) {
      dirty = false;
      phases();
      plane();
      strips();
      if (now - read > READING) { read = now; preview(); numbers(); }
    }
    requestAnimationFrame(draw);
  }

  // ---- hands
  function clicked(event) {
    if (!setup) return;
    const box = $("plane").getBoundingClientRect();
    const x = frame(box.width, box.height).back(event.clientX - box.left, event.clientY - box.top);
    const what = document.querySelector("input[name=click]:checked").value;
    if (x.some((one, k) => one < setup.low[k] || one > setup.high[k])) {
      notice(`(${x.map((one) => one.toFixed(4)).join(", ")}) m lies outside of what the robot reaches: click nearer to it.`);
      return;
    }
    notice("");
    if (what === "point") nearby(x); else {
      if ($("kind").value !== "trip" && what === "goal") $("kind").value = "trip";
      place(what, x);
      kind();
    }
  }
  async function nearby(x) {
    const answer = await ask("near", {point: x});
    if (!answer.ok) { notice(sentence(answer.text)); return; }
    $("kind").value = "point";
    place("point", answer.point);
    kind();
  }
  function hands() {
    let pressed = 0;
    $("stop").addEventListener("pointerdown", () => { pressed = performance.now(); stop(); });
    $("stop").addEventListener("click", () => { if (performance.now() - pressed > 1000) stop(); });
    const types = (target) => target.matches?.("textarea, input[type=text], input[type=search]");
    document.addEventListener("keydown", (event) => {
      if (event.code !== "Space" || types(event.target)) return;
      event.preventDefault();
      if (!event.repeat) stop();
    }, true);
    document.addEventListener("keyup", (event) => { if (event.code === "Space" && !types(event.target)) event.preventDefault(); }, true);
    $("take").onclick = () => order("drive");
    $("on").onclick = () => order("enable", {on: true});
    $("off").onclick = () => order("enable", {on: false});
    $("reset").onclick = () => order("reset");
    $("why").lastElementChild.onclick = (event) => order(event.target.dataset.action, {on: true});
    $("plane").addEventListener("click", clicked);
    $("plane").addEventListener("pointermove", (event) => {
      if (!setup) return;
      const box = $("plane").getBoundingClientRect();
      put($("cursor"), `(${frame(box.width, box.height).back(event.clientX - box.left, event.clientY - box.top).map((one) => one.toFixed(4)).join(", ")}) m`);
    });
    $("task").addEventListener("submit", go);
    $("task").addEventListener("input", () => { kind(); dirty = true; });
    $("here").onclick = () => { if (state && state.x.every(known)) { place("start", state.x); replan(); } };
    $("law").addEventListener("submit", (event) => {
      event.preventDefault();
      const values = {};
      for (const name of ["law", "estimator"]) if ($(`law-${name}`).value !== status.controller[name]) values[name] = $(`law-${name}`).value;
      if (Object.keys(values).length) order("set", {node: "controller", values});
    });
    $("node").onchange = $("find").oninput = () => { if (setup) fields(); };
    const labels = () => ({name: $("name").value, notes: $("notes").value});
    $("record-on").onclick = () => order("record", {on: true, ...labels()});
    $("record-off").onclick = () => order("record", {on: false, ...labels()});
    $("record").addEventListener("submit", (event) => event.preventDefault());
    $("report").onclick = () => { say("The report is being made \u2026"); order("report"); };
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", palette);
    matchMedia("(monochrome)").addEventListener("change", palette);
    new ResizeObserver(size).observe(document.body);
  }

  palette();
  hands();
  kind();
  if (typeof WebSocket !== "function") {
    link("this browser cannot watch", true);
    notice("This browser has no WebSocket, which the panel needs: open the page in another. In a terminal dextar stop stops the robot.");
  } else connect();
  requestAnimationFrame(draw);
})();
