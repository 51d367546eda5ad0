/** @file Nodes from calls. Text is always text: nothing here, or in any module, reads markup. */

const SVG = "http://www.w3.org/2000/svg";

/** @typedef {Node | string | number | null | undefined | false | Child[]} Child */

/**
 * Return an element of HTML.
 * @param {string} tag
 * @param {Object<string, any>} attributes Properties, `class`, `aria-…`, `data-…`, `on…` listeners, `style` as an object.
 * @param {...Child} children Null and false are left out.
 * @returns {any}
 */
export function element(tag, attributes = {}, ...children) {
  return filled(document.createElement(tag), attributes, children);
}

/**
 * Return an element of SVG; its attributes are attributes.
 * @param {string} tag @param {Object<string, any>} attributes @param {...Child} children
 * @returns {any}
 */
export function svg(tag, attributes = {}, ...children) {
  return filled(document.createElementNS(SVG, tag), attributes, children);
}

/** Replace the children of a node. @param {Element} node @param {...Child} children */
export function fill(node, ...children) {
  node.replaceChildren(...flat(children));
  return node;
}

/**
 * Set the text of a node where it is another: a reader of the screen hears changes only.
 * @param {Element} node @param {string} text
 */
export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/**
 * Return a function that asks for one drawing with the next frame, however often it is called before.
 * @param {() => void} draw
 */
export function onFrame(draw) {
  let asked = 0;
  return () => {
    asked ||= requestAnimationFrame(() => {
      asked = 0;
      draw();
    });
  };
}

/** Draw at once, then each half second while the node is on the page. @param {() => void} draw @param {Element} node */
export function every(draw, node) {
  draw();
  const timer = setInterval(() => (node.isConnected ? draw() : clearInterval(timer)), 500);
  return node;
}

function filled(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) assign(node, name, value);
  node.append(...flat(children));
  return node;
}

function flat(children) {
  return children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false).map((child) =>
    child instanceof Node ? child : String(child),
  );
}

function assign(node, name, value) {
  if (value === null || value === undefined) return;
  if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
  else if (name === "style") for (const [property, text] of Object.entries(value)) node.style.setProperty(property, text);
  else if (name.startsWith("aria-")) node.setAttribute(name, String(value));
  else if (value === false) return;
  else if (name in node && !(node instanceof SVGElement) && name !== "list") node[name] = value;
  else node.setAttribute(name, value === true ? "" : String(value));
}
