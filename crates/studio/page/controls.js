/**
 * The controls of the panel: numbers, colours, choices, and the direction of a light. Each is an element with a method `update`
 * that shows the present value.
 *
 * @typedef {HTMLElement & {update: () => void}} Control
 */

/**
 * An element.
 * @template {keyof HTMLElementTagNameMap} T
 * @param {T} tag
 * @param {Object<string, any>} [properties] attributes; those that are functions become listeners
 * @param {(Node | string)[]} children
 * @returns {HTMLElementTagNameMap[T]}
 */
export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (typeof value === "function") made.addEventListener(name, value);
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value !== undefined) made.setAttribute(name, String(value));
  }
  made.append(...children);
  return made;
}

/**
 * Makes an element a control.
 * @param {HTMLElement} made
 * @param {() => void} update
 * @returns {Control}
 */
function control(made, update) {
  update();
  return Object.assign(made, { update });
}

/**
 * @param {number} value
 * @param {number} step
 */
function written(value, step) {
  const digits = Math.max(0, Math.ceil(-Math.log10(step) - 1e-9));
  return value.toFixed(digits);
}

let numbered = 0;

/**
 * A number: dragged, typed, or moved by arrow keys.
 * @param {object} options
 * @param {string} options.label
 * @param {string} [options.unit]
 * @param {number} options.min
 * @param {number} options.max
 * @param {number} options.step
 * @param {string} [options.hint]
 * @param {boolean} [options.slider]
 * @param {() => number} options.get
 * @param {(value: number) => void} options.set
 * @param {() => number} options.initial what reset goes back to
 */
export function number({ label, unit = "", min, max, step, hint, slider = true, get, set, initial }) {
  const id = `n${++numbered}`;
  const typed = element("input", {
    id, type: "text", inputmode: "decimal", autocomplete: "off", spellcheck: "false", class: "typed",
    "aria-label": `${label}${unit ? `, ${unit}` : ""}, ${min} to ${max}`,
    change: () => take(Number(typed.value.replace(",", ".").replace("−", "-"))),
    keydown: (/** @type {KeyboardEvent} */ event) => {
      const way = { ArrowUp: 1, ArrowDown: -1 }[event.key];
      if (way) {
        event.preventDefault();
        take(get() + way * step * (event.shiftKey ? 10 : 1));
      }
      if (event.key === "Enter") typed.select();
    },
    focus: () => typed.select(),
  });
  const range = element("input", {
    type: "range", min, max, step: step / 10, class: "range", tabindex: slider ? "0" : "-1", "aria-label": label,
    input: () => take(Number(range.value)),
    keydown: (/** @type {KeyboardEvent} */ event) => {
      const way = { ArrowUp: 1, ArrowRight: 1, ArrowDown: -1, ArrowLeft: -1 }[event.key];
      if (way) {
        event.preventDefault();
        take(get() + way * step * (event.shiftKey ? 10 : 1));
      }
    },
  });
  const reset = element("button", { type: "button", class: "reset", title: `Reset ${label.toLowerCase()}`, "aria-label": `Reset ${label}`, click: () => take(initial()) }, "↺");
  function take(/** @type {number} */ value) {
    if (Number.isFinite(value)) set(Math.min(Math.max(value, min), max));
    made.update();
  }
  const span = `${min} to ${max}${unit ? ` ${unit}` : ""}`.replaceAll("-", "−");
  const name = element("label", { for: id, class: "name", title: hint ? `${hint}: ${span}` : span }, label);
  name.addEventListener("pointerdown", (event) => {
    // The name is dragged, too: a range of 300 pixels.
    event.preventDefault();
    const [from, start] = [event.clientX, get()];
    let moved = false;
    const move = (/** @type {PointerEvent} */ to) => {
      moved ||= Math.abs(to.clientX - from) > 2;
      if (moved) take(start + ((to.clientX - from) * (max - min)) / (to.shiftKey ? 3000 : 300));
    };
    const up = () => {
      removeEventListener("pointermove", move);
      removeEventListener("pointerup", up);
      if (!moved) typed.focus();
    };
    addEventListener("pointermove", move);
    addEventListener("pointerup", up);
  });
  const made = control(
    element("div", { class: slider ? "control number" : "control number plain" }, name, reset, element("span", { class: "value" }, typed, element("span", { class: "unit" }, unit)), ...(slider ? [range] : [])),
    () => {
      const value = get();
      if (document.activeElement !== typed || Number(typed.value) !== value) typed.value = written(value, step);
      range.value = String(value);
      range.style.setProperty("--filled", `${(100 * (value - min)) / (max - min)}%`);
      range.setAttribute("aria-valuetext", `${written(value, step)} ${unit}`.trim());
      reset.classList.toggle("hidden", Math.abs(value - initial()) < step / 20);
    },
  );
  return made;
}

/**
 * A colour.
 * @param {object} options
 * @param {string} options.label
 * @param {string} [options.hint]
 * @param {() => string} options.get as #rrggbb
 * @param {(hex: string) => void} options.set
 * @param {() => string} options.initial
 */
export function colour({ label, hint, get, set, initial }) {
  const id = `n${++numbered}`;
  const picker = element("input", { type: "color", class: "swatch", "aria-label": label, input: () => take(picker.value) });
  const typed = element("input", {
    id, type: "text", class: "typed hex", spellcheck: "false", maxlength: "7", "aria-label": `${label}, as #rrggbb`,
    change: () => take(typed.value.trim().toLowerCase()), focus: () => typed.select(),
  });
  const reset = element("button", { type: "button", class: "reset", title: `Reset ${label.toLowerCase()}`, "aria-label": `Reset ${label}`, click: () => take(initial()) }, "↺");
  function take(/** @type {string} */ hex) {
    if (/^#[0-9a-f]{6}$/.test(hex)) set(hex);
    made.update();
  }
  const made = control(
    element("div", { class: "control colour" }, element("label", { for: id, class: "name", title: hint ?? false }, label), reset, element("span", { class: "value" }, typed, picker)),
    () => {
      picker.value = get();
      if (document.activeElement !== typed) typed.value = get();
      reset.classList.toggle("hidden", get() === initial());
    },
  );
  return made;
}

/**
 * One of a few.
 * @param {object} options
 * @param {string} options.label
 * @param {boolean} [options.quiet] whether the label is only read out
 * @param {[string, string][]} options.options value and text
 * @param {() => string} options.get
 * @param {(value: string) => void} options.set
 */
export function segments({ label, quiet = false, options, get, set }) {
  const buttons = options.map(([value, text]) => element("button", {
    type: "button", role: "radio", class: "segment", "data-value": value, click: () => { set(value); made.update(); },
    keydown: (/** @type {KeyboardEvent} */ event) => {
      const way = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
      if (!way) return;
      event.preventDefault();
      const at = (options.findIndex(([other]) => other === get()) + way + options.length) % options.length;
      set(options[at][0]);
      made.update();
      buttons[at].focus();
    },
  }, text));
  const made = control(
    element("div", { class: quiet ? "control segmented quiet" : "control segmented" },
      ...(quiet ? [] : [element("span", { class: "name" }, label)]),
      element("div", { class: "segments", role: "radiogroup", "aria-label": label }, ...buttons)),
    () => buttons.forEach((button) => {
      const chosen = button.dataset.value === get();
      button.setAttribute("aria-checked", String(chosen));
      button.tabIndex = chosen ? 0 : -1;
    }),
  );
  return made;
}

/**
 * One of many.
 * @param {object} options
 * @param {string} options.label
 * @param {string} [options.name] that screen readers say, where the label is not enough
 * @param {() => [string, string][]} options.options value and text
 * @param {() => string} options.get
 * @param {(value: string) => void} options.set
 */
export function choice({ label, name, options, get, set }) {
  const id = `n${++numbered}`;
  const select = element("select", { id, class: "select", "aria-label": name, change: () => { set(select.value); made.update(); } });
  const made = control(element("div", { class: "control chosen" }, element("label", { for: id, class: "name" }, label), select), () => {
    const wanted = options();
    if (JSON.stringify(wanted) !== select.dataset.options) {
      select.dataset.options = JSON.stringify(wanted);
      select.replaceChildren(...wanted.map(([value, text]) => element("option", { value }, text)));
    }
    select.value = get();
  });
  return made;
}

/**
 * Switches that belong together.
 * @param {object} options
 * @param {string} options.label
 * @param {[string, string][]} options.options
 * @param {() => string[]} options.get
 * @param {(values: string[]) => void} options.set
 */
export function switches({ label, options, get, set }) {
  const buttons = options.map(([value, text]) => element("button", {
    type: "button", class: "chip", "data-value": value,
    click: (/** @type {MouseEvent} */ event) => {
      const on = get();
      // With Alt it is shown alone.
      set(event.altKey ? [value] : on.includes(value) ? on.filter((other) => other !== value) : [...on, value]);
      made.update();
    },
  }, text));
  const made = control(
    element("div", { class: "control switches" }, element("span", { class: "name", title: "Alt-click shows one alone" }, label), element("div", { class: "chips", role: "group", "aria-label": label }, ...buttons)),
    () => buttons.forEach((button) => button.setAttribute("aria-pressed", String(get().includes(button.dataset.value ?? "")))),
  );
  return made;
}

/**
 * The direction of a light on the hemisphere in front, seen from the eye.
 * @param {object} options
 * @param {() => [number, number]} options.get azimuth and elevation in degrees
 * @param {(azimuth: number, elevation: number) => void} options.set
 */
export function direction({ get, set }) {
  const dot = element("span", { class: "dot" });
  const pad = element("div", {
    class: "pad", tabindex: "0", role: "slider", "aria-label": "Direction of the light", "aria-valuemin": "-180", "aria-valuemax": "180",
    keydown: (/** @type {KeyboardEvent} */ event) => {
      const step = event.shiftKey ? 10 : 2;
      const [x, y] = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] }[event.key] ?? [0, 0];
      if (x || y) {
        event.preventDefault();
        const [azimuth, elevation] = get();
        turn(azimuth + x, elevation + y);
      }
    },
    pointerdown: (/** @type {PointerEvent} */ event) => {
      pad.setPointerCapture(event.pointerId);
      follow(event);
    },
    pointermove: (/** @type {PointerEvent} */ event) => { if (pad.hasPointerCapture(event.pointerId)) follow(event); },
  }, dot);
  function turn(/** @type {number} */ azimuth, /** @type {number} */ elevation) {
    set(((azimuth + 540) % 360) - 180, Math.min(Math.max(elevation, -10), 90));
    made.update();
  }
  function follow(/** @type {PointerEvent} */ event) {
    const box = pad.getBoundingClientRect();
    // Above: the middle is the zenith, the rim the horizon, below is the front.
    const [x, y] = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height].map((v) => 2 * v - 1);
    const r = Math.min(Math.hypot(x, y), 1);
    turn((Math.atan2(x, y) * 180) / Math.PI, 90 * (1 - r));
  }
  const made = control(element("div", { class: "control pad-row" }, pad), () => {
    const [azimuth, elevation] = get();
    const r = 1 - Math.max(elevation, 0) / 90;
    dot.style.left = `${50 + 44 * r * Math.sin((azimuth * Math.PI) / 180)}%`;
    dot.style.top = `${50 + 44 * r * Math.cos((azimuth * Math.PI) / 180)}%`;
    pad.setAttribute("aria-valuenow", String(Math.round(azimuth)));
    pad.setAttribute("aria-valuetext", `azimuth ${Math.round(azimuth)} degrees, elevation ${Math.round(elevation)} degrees`);
  });
  return made;
}
