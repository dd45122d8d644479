// Words whose contrast with what is painted behind them is under 4.5, by the formula of WCAG 2.
const parse = (text) => (text.match(/[\d.]+/g) || []).map(Number);
const linear = (value) => (value <= 0.03928 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4);
const luminance = ([r, g, b]) =>
  0.2126 * linear(r / 255) + 0.7152 * linear(g / 255) + 0.0722 * linear(b / 255);
const ground = (element) => {
  for (let at = element; at; at = at.parentElement) {
    const colour = parse(getComputedStyle(at).backgroundColor);
    if (colour.length === 3 || colour[3] === 1) return colour;
  }
  return [255, 255, 255];
};
return [...document.querySelectorAll("body *")].filter((element) =>
  !element.closest("svg, script, noscript, #readout, select") &&
  [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim())
).map((element) => {
  const ink = luminance(parse(getComputedStyle(element).color)), paper = luminance(ground(element));
  return [(Math.max(ink, paper) + 0.05) / (Math.min(ink, paper) + 0.05), element.className, element.textContent.slice(0, 40)];
}).filter(([contrast]) => contrast < 4.5);
