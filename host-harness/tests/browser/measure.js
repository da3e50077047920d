// What a reader would see of the pages in the frames, as JSON into an element of this page. Runs when all
// frames have loaded, and has no one to wait for.
const box = element => {
  const { width, height, left, right, top, bottom } = element.getBoundingClientRect();
  return { width, height, left, right, top, bottom };
};
const textOf = element => (element?.textContent ?? "").trim();

// Whether an element's own box, or one around it, scrolls sideways: what is wide there is within reach.
const scrolls = element => {
  for (let at = element; at && at.localName !== "body"; at = at.parentElement) {
    const { overflowX } = at.ownerDocument.defaultView.getComputedStyle(at);
    if (overflowX === "auto" || overflowX === "scroll") return true;
  }
  return false;
};

// Whether a picture is decoded down to its last pixel, and how many colours it has of the first few.
const pixels = image => {
  if (!image.complete || image.naturalWidth === 0) return { is_decoded: false, colours: 0 };
  const canvas = image.ownerDocument.createElement("canvas");
  [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight];
  const context = canvas.getContext("2d");
  context.drawImage(image, 0, 0);
  const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
  const words = new Uint32Array(data.buffer);
  const colours = new Set();
  for (let i = 0; i < words.length && colours.size < 8; i++) colours.add(words[i]);
  return { is_decoded: data[data.length - 1] === 255, colours: colours.size };
};

const picture = element => {
  const isImage = element.localName === "img";
  return {
    kind: element.localName,
    caption: textOf(element.closest("figure")?.querySelector("figcaption")),
    width: box(element).width,
    height: box(element).height,
    natural_width: isImage ? element.naturalWidth : element.viewBox.baseVal.width,
    natural_height: isImage ? element.naturalHeight : element.viewBox.baseVal.height,
    ...(isImage ? pixels(element) : { is_decoded: true, colours: element.querySelectorAll("*").length }),
  };
};

const table = element => ({
  title: textOf(element.closest("section")?.querySelector("h3")),
  head: element.querySelectorAll("thead th").length,
  rows: element.querySelectorAll("tbody tr").length,
  empty_cells: [...element.querySelectorAll("th, td")].filter(cell => textOf(cell) === "").length,
  width: box(element).width,
  height: box(element).height,
});

// Every piece of text with the size that its letters have on the screen, and where it stands.
const texts = document => {
  const found = [];
  const walker = document.createTreeWalker(document.body, 4 /* text */);
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    const text = walker.currentNode.data.trim();
    if (text === "" || ["script", "style"].includes(element.localName)) continue;
    const style = document.defaultView.getComputedStyle(element);
    const svg = element.closest("svg");
    const scale = svg ? svg.getScreenCTM().a : 1;
    const range = document.createRange();
    range.selectNodeContents(walker.currentNode);
    found.push({ element, svg, text, px: parseFloat(style.fontSize) * scale, place: box(svg ? element : range) });
  }
  return found;
};

// Attributes of addresses, and what styles name, that lie outside of the page.
const addresses = document => {
  const outside = [];
  const isOutside = address => address !== "" && !address.startsWith("#") && !address.startsWith("data:");
  for (const element of document.querySelectorAll("*")) {
    for (const { name, value } of element.attributes) {
      const isAddress = ["src", "srcset", "href", "xlink:href", "data", "action", "poster"].includes(name);
      if (isAddress && isOutside(value.trim())) outside.push(`${name}=${value}`);
      if (name === "style" || name === "fill" || name === "stroke") styles(value, outside, isOutside);
    }
    if (element.localName === "style") styles(element.textContent, outside, isOutside);
  }
  const fetched = document.defaultView.performance.getEntriesByType("resource").map(entry => entry.name);
  return outside.concat(fetched.filter(isOutside));
};
const styles = (text, outside, isOutside) => {
  for (const [, address] of text.matchAll(/url\(\s*['"]?([^'")]*)/g)) if (isOutside(address)) outside.push(address);
  if (text.includes("@import")) outside.push("@import");
};

const page = frame => {
  const document = frame.contentDocument;
  const root = document.documentElement;
  const found = texts(document);
  const least = of => {
    const px = Math.min(...of.map(text => text.px));
    return of.length === 0 ? null : { px, text: of.find(text => text.px === px).text };
  };
  const isCut = ({ svg, place }) => {
    if (!svg) return false;
    const around = box(svg);
    return place.left < around.left - 1 || place.right > around.right + 1
      || place.top < around.top - 1 || place.bottom > around.bottom + 1;
  };
  const spills = ({ element, svg, place }) => {
    return (place.right > root.clientWidth + 1 || place.left < -1) && !scrolls(svg ?? element);
  };
  const links = [...document.querySelectorAll("a[href^='#']")].map(link => link.getAttribute("href").slice(1));
  return {
    width: root.clientWidth,
    scroll_width: Math.max(root.scrollWidth, document.body.scrollWidth),
    tables: [...document.querySelectorAll("table")].map(table),
    pictures: [...document.querySelectorAll("svg, img")].map(picture),
    least_text: least(found.filter(text => !text.svg)),
    least_chart_text: least(found.filter(text => text.svg)),
    cut_texts: found.filter(isCut).map(text => text.text),
    spilling_texts: found.filter(spills).map(text => text.text),
    addresses: addresses(document),
    dead_links: links.filter(link => !document.getElementById(link)),
  };
};

window.onload = () => {
  const measures = [...document.querySelectorAll("iframe")].map(page);
  // Nothing that HTML would write otherwise.
  const plain = letter => "\\u" + letter.charCodeAt(0).toString(16).padStart(4, "0");
  document.getElementById("measures").textContent = JSON.stringify(measures).replace(/[^ -~]|[<>&]/g, plain);
};
