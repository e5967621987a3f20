"use strict";
const byId = (id) => document.getElementById(id);

// The payload: 8 bytes with the length of the JSON text, the text, then the block of arrays.
async function unpack() {
  const packed = Uint8Array.from(atob(byId("payload").textContent), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const buffer = await new Response(stream).arrayBuffer();
  const length = Number(new DataView(buffer).getBigUint64(0, true));
  const text = new TextDecoder().decode(new Uint8Array(buffer, 8, length));
  const block = Math.ceil((8 + length) / 8) * 8;
  return JSON.parse(text, (key, value) => value && value.typed
    ? new window[value.typed](buffer, block + value.start, value.length) : value);
}

function showFacts(facts) {
  document.querySelector("#about h1").textContent = facts.title;
  byId("note").textContent = facts.note;
  for (const [name, color, force] of facts.legend) {
    const chip = document.createElement("span");
    chip.className = "chip";
    chip.style.setProperty("--color", color);
    chip.textContent = name;
    chip.dataset.arm = name;
    if (force !== null) chip.title = `force on the object up to ${force}`;
    byId("legend").append(chip);
  }
  for (const [name, sign, color] of facts.states) {
    const mark = signed(sign, color), word = document.createElement("em");
    word.textContent = name;
    mark.append(word);
    byId("states").append(mark);
  }
  if (facts.scale) {
    byId("scale").textContent = facts.scale;
    byId("scale").title = "dark arrows push the object, light ones pull it";
  }
}

// Shows where a joint is between its limits, after its arm's name; returns what refreshes it.
function addDial({ arm, unit, limits: [low, high], passed_at: [least, most], values }, times) {
  const chip = [...document.querySelectorAll(".chip")].find((chip) => chip.dataset.arm === arm);
  const text = document.createElement("span");
  text.className = "dial";
  text.title = "position of the joint since the start, in its limits";
  chip?.append(text);
  const digits = high - low < 10 ? 1 : 0;
  const shown = (value) => Number(value.toFixed(digits)).toFixed(digits).replace("-", "\u2212");
  return (time) => {
    const after = times.findIndex((t) => t >= time);
    const k = after < 0 ? times.length - 1 : Math.max(1, after);
    const span = times[k] - times[k - 1];
    const share = span > 0 ? Math.min(1, (time - times[k - 1]) / span) : 0;
    const value = share > 0 ? values[k - 1] + share * (values[k] - values[k - 1]) : values[0];
    text.classList.toggle("beyond", value < least || value > most);
    text.textContent = `${shown(value)}${unit} in ${shown(low)} \u2026 ${shown(high)}${unit}`;
  };
}

function signed(sign, color) {
  const mark = document.createElement("span");
  mark.className = "sign";
  mark.style.setProperty("--color", color);
  mark.textContent = sign;
  return mark;
}

// Ticks over the time line; a click goes to the nearest of them.
function addTicks({ ticks, families }, duration, jump) {
  const strip = byId("ticks");
  for (const { at, families: present } of ticks) {
    for (const family of present) {
      const tick = document.createElement("i");
      tick.className = `f${family}`;
      tick.style.setProperty("--color", families[family][2]);
      tick.style.left = `${100 * at / duration}%`;
      strip.append(tick);
    }
  }
  const nearest = (event) => {
    const box = strip.getBoundingClientRect();
    const at = (event.clientX - box.left) / box.width * duration;
    return ticks.reduce((a, b) => (Math.abs(b.at - at) < Math.abs(a.at - at) ? b : a));
  };
  strip.addEventListener("mousemove", (event) => { strip.title = nearest(event).words; });
  strip.addEventListener("click", (event) => jump(nearest(event).at));
}

// The list of events, and a line that says what has just happened; returns what refreshes both.
function addEvents({ count, families, rows, unlisted }, jump) {
  const list = document.querySelector("#events ol"), line = byId("happening"), lasting = 1.0;
  byId("events").hidden = rows.length === 0;
  document.querySelector("#events summary").textContent = `events (${count})`;
  const buttons = rows.map(({ at, family, words: [time, what, change] }) => {
    const [name, sign, color] = families[family];
    const item = document.createElement("li"), button = document.createElement("button");
    const text = document.createElement("span"), when = document.createElement("span");
    when.className = "time";
    when.textContent = `${time} `;
    text.append(when, what);
    button.title = name;
    button.append(signed(sign, color), text);
    if (change) {
      const detail = document.createElement("span");
      detail.className = "change";
      detail.textContent = change;
      button.append(detail);
    }
    button.addEventListener("click", () => jump(at));
    item.append(button);
    list.append(item);
    return button;
  });
  if (unlisted > 0) {
    const rest = document.createElement("li");
    rest.textContent = `and ${unlisted} more, in the trajectory's events`;
    list.append(rest);
  }
  let shown = -1;
  return (time) => {
    let now = -1;
    for (let low = 0, high = rows.length; low < high;) {
      const middle = (low + high) >> 1;
      if (rows[middle].at <= time + 1e-6) { now = middle; low = middle + 1; } else high = middle;
    }
    line.hidden = now < 0 || time - rows[now].at > lasting;
    if (now === shown) return;
    buttons[shown]?.classList.remove("now");
    buttons[now]?.classList.add("now");
    if (byId("events").open) buttons[now]?.scrollIntoView({ block: "nearest" });
    if (now >= 0) {
      const [, sign, color] = families[rows[now].family];
      line.replaceChildren(signed(sign, color), ` ${rows[now].words[1]}`);
    }
    shown = now;
  };
}

function addLayer(viewer, path, label) {
  if (!(path in viewer.scene_tree.find(["world"]).children)) return;
  const box = document.createElement("input");
  box.type = "checkbox";
  box.checked = true;
  box.addEventListener("change", () => {
    viewer.set_property(["world", path], "visible", box.checked);
    viewer.set_dirty();
  });
  const element = document.createElement("label");
  element.append(box, label);
  byId("layers").append(element);
}

// The scene was framed for one shape of window; a narrower one needs more distance.
function fitCamera(viewer, aspect) {
  // a frame that is not shown has no size; the camera is fitted when it has one
  if (!window.innerWidth || !window.innerHeight) {
    window.addEventListener("resize", () => fitCamera(viewer, aspect), { once: true });
    return;
  }
  const width = window.innerWidth / window.innerHeight;
  viewer.camera.position.multiplyScalar(Math.max(1, aspect / width));
  viewer.set_dirty();
}

function addPlayer(viewer, facts) {
  const animator = viewer.animator;
  const dials = facts.dials.map((dial) => addDial(dial, facts.times));
  dials.forEach((show) => show(0));
  if (animator.duration === 0) return;
  const [button, seek, clock, rate] = ["play", "seek", "clock", "rate"].map(byId);
  const icons = { play: "M2 0 L13 7 L2 14 Z", pause: "M1 0 H5 V14 H1 Z M9 0 H13 V14 H9 Z" };
  const end = facts.start + animator.duration * facts.speed;
  byId("bar").hidden = false;
  seek.max = animator.duration;
  for (const factor of [0.1, 0.25, 0.5, 1, 2, 4]) {
    rate.add(new Option(`${factor}×`, factor, factor === 1, factor === 1));
  }
  const toggle = () => (animator.playing ? animator.pause() : animator.play());
  button.addEventListener("click", toggle);
  window.addEventListener("keydown", (event) => {
    if (event.code !== "Space" || event.target.closest("button, select, summary")) return;
    event.preventDefault();
    toggle();
  });
  const jump = (time) => {
    animator.pause();
    animator.seek(time);
    animator.display_progress(time);
    viewer.set_dirty();
  };
  seek.addEventListener("input", () => jump(Number(seek.value)));
  addTicks(facts.events, animator.duration, jump);
  const showEvents = addEvents(facts.events, jump);
  rate.addEventListener("change", () => { animator.mixer.timeScale = Number(rate.value); });
  const refresh = () => {
    button.querySelector("path").setAttribute("d", animator.playing ? icons.pause : icons.play);
    if (document.activeElement !== seek || animator.playing) seek.value = animator.time;
    dials.forEach((show) => show(animator.time * facts.speed));
    showEvents(animator.time);
    const time = facts.start + animator.time * facts.speed;
    clock.textContent = `${time.toFixed(2)} / ${end.toFixed(2)} s`;
    requestAnimationFrame(refresh);
  };
  refresh();
}

const viewer = new MeshCat.Viewer(byId("meshcat-pane"));
unpack().then(({ facts, commands }) => {
  commands.forEach((command) => viewer.handle_command(command));
  showFacts(facts);
  addLayer(viewer, "forces", "forces");
  addLayer(viewer, "contacts", "contacts and normals");
  addLayer(viewer, "regions", "where fingertips may go");
  addLayer(viewer, "joints", "joint axes");
  addLayer(viewer, "events", "flashes of events");
  fitCamera(viewer, facts.aspect);
  addPlayer(viewer, facts);
  document.body.dataset.ready = "true";
}).catch((error) => {
  byId("note").textContent = `This browser cannot show the replay: ${error}`;
  throw error;
});
