// Helpers for elements. Data from outside are only set as text, never as HTML.

export const $ = (id) => document.getElementById(id);

export function make(tag, { text, ...attributes } = {}, ...children) {
  const element = tag.startsWith("svg:")
    ? document.createElementNS("http://www.w3.org/2000/svg", tag.slice(4))
    : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  if (text !== undefined) element.textContent = text;
  element.append(...children);
  return element;
}

export function say(id, text) {
  const element = $(id);
  if (element.textContent !== text) element.textContent = text;
}

// Calls `show` only when its argument has changed.
export function once(show) {
  let before;
  return (value) => {
    const now = JSON.stringify(value);
    if (now !== before) {
      before = now;
      show(value);
    }
  };
}

export const colour = (name) =>
  getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

// Sets a canvas to the screen's resolution; returns its size in CSS pixels.
export function fitted(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = canvas;
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

export function picture(kind, base64) {
  return new Promise((resolve, reject) => {
    const image = new Image();
    image.onload = () => resolve(image);
    image.onerror = () => reject(new Error(`not a valid ${kind} image`));
    image.src = `data:image/${kind};base64,${base64}`;
  });
}

const TARGETS = {
  light: ["#d6225b", "#1c7ed6", "#9c36b5", "#0b7285", "#8d5524", "#5c940d", "#6741d9", "#5c6b7f"],
  dark: ["#ff5c8d", "#4dabf7", "#da77f2", "#3bc9db", "#d9a066", "#a9e34b", "#9775fa", "#adb5bd"],
};

export function colourOf(label, targets) {
  const at = targets.indexOf(label);
  const colours = TARGETS[document.documentElement.dataset.scheme];
  return at < 0 ? colour("thing") : colours[at % colours.length];
}

export function clock(t_s) {
  if (t_s > 1e9) return new Date(t_s * 1000).toTimeString().slice(0, 8);
  const minutes = Math.floor(t_s / 60);
  return `${minutes}:${(t_s - 60 * minutes).toFixed(1).padStart(4, "0")}`;
}
