// The parts of the page around the picture: made here, so that the page is one list of what there is.

/** An element with attributes, and children or text. */
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith('on')) element.addEventListener(name.slice(2), value);
    else if (value !== false && value != null) element.setAttribute(name, value === true ? '' : value);
  }
  element.append(...children);
  return element;
}

/** A section of the panel that opens and closes. */
export function section(title, isOpen, ...children) {
  return make('details', { open: isOpen }, make('summary', {}, title), make('div', { class: 'rows' }, ...children));
}

/** A control with its name above it. */
export function named(name, control) {
  return make('div', { class: 'named' }, make('span', { class: 'name' }, name), control);
}

/** A slider over a logarithmic range: the value is shown beside its name. */
export function slider(name, { low, high, value, show, hint, digits = 2 }, onChange) {
  const output = make('output', {}, show(value));
  const toPlace = (v) => (1000 * Math.log(v / low)) / Math.log(high / low);
  const rounded = (v) => Number(v.toPrecision(digits));
  const input = make('input', {
    type: 'range', min: 0, max: 1000, step: 1, 'aria-label': name,
    oninput: () => {
      const v = rounded(low * (high / low) ** (input.value / 1000));
      tell(v);
      onChange(v);
    },
  });
  const tell = (v) => {
    output.value = show(v);
    input.setAttribute('aria-valuetext', show(v)); // its own value is a place from 0 to 1000
  };
  const set = (v) => {
    input.value = toPlace(v);
    tell(v);
  };
  set(value);
  const row = make('label', { class: 'slider', title: hint ?? '' }, make('span', {}, name), output, input);
  row.setValue = set;
  return row;
}

/** A slider over a plain range of numbers from 0 to 1. */
export function share(name, value, onChange) {
  const input = make('input', { type: 'range', min: 0, max: 1, step: 0.001, value, 'aria-label': name, oninput: () => onChange(Number(input.value)) });
  const row = make('label', { class: 'slider short' }, make('span', {}, name), input);
  row.setValue = (v) => (input.value = v);
  return row;
}

/** One of several: buttons in a row. */
export function choice(name, options, value, onChange) {
  const buttons = options.map(([key, text, hint]) => make('button', { type: 'button', title: hint ?? '', onclick: () => pick(key) }, text));
  const pick = (key, isQuiet = false) => {
    buttons.forEach((button, i) => button.setAttribute('aria-pressed', String(options[i][0] === key)));
    if (!isQuiet) onChange(key);
  };
  pick(value, true);
  const row = make('div', { class: 'choice', role: 'group', 'aria-label': name }, ...buttons);
  row.pick = pick;
  return row;
}

/** A box to tick. */
export function tick(name, value, onChange, hint = '') {
  const input = make('input', { type: 'checkbox', onchange: () => onChange(input.checked) });
  input.checked = value;
  const row = make('label', { class: 'tick', title: hint }, input, make('span', {}, name));
  row.input = input;
  return row;
}

export function button(text, hint, onclick) {
  return make('button', { type: 'button', title: hint, onclick }, text);
}

export const count = (n) => (n >= 1e6 ? `${(n / 1e6).toFixed(n >= 1e7 ? 1 : 2)} M` : n >= 1e4 ? `${Math.round(n / 1e3)} k` : String(Math.round(n)));
export const bytes = (n) => (n >= 1e6 ? `${(n / 1e6).toFixed(1)} MB` : `${Math.round(n / 1e3)} kB`);
