// What is hard to read on a page, for test_report_in_browser.py: contrasts, and what lies outside of the page.
({ canScroll }) => {
  const TEXT = 4.5, LINE = 3, problems = [], count = { texts: 0, lines: 0 };
  for (const box of document.querySelectorAll("details")) box.open = true;

  const parse = colour => {
    const [r, g, b, a = 1] = colour.match(/[\d.]+/g)?.map(Number) ?? [0, 0, 0, 0];
    return { rgb: [r, g, b], a: colour === "none" || colour === "transparent" ? 0 : a };
  };
  const over = (top, below) => top.rgb.map((value, i) => top.a * value + (1 - top.a) * below[i]);
  const luminance = rgb => {
    const [r, g, b] = rgb.map(value => (value /= 255) <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const contrast = (first, second) => {
    const [low, high] = [luminance(first), luminance(second)].sort((a, b) => a - b);
    return (high + 0.05) / (low + 0.05);
  };
  const opacity = element => {
    let product = 1;
    for (let node = element; node instanceof Element; node = node.parentElement) product *= getComputedStyle(node).opacity;
    return product;
  };

  // A filled shape that covers much of a figure is its background.
  const backgrounds = new Map();
  for (const svg of document.querySelectorAll("svg")) {
    const size = svg.getBoundingClientRect();
    for (const shape of svg.querySelectorAll("path, rect")) {
      if (shape.closest("defs, clipPath")) continue;
      const box = shape.getBoundingClientRect(), style = getComputedStyle(shape), fill = parse(style.fill);
      if (fill.a * style.fillOpacity * opacity(shape) === 1 && box.width * box.height > 0.2 * size.width * size.height && box.height > 30)
        backgrounds.set(svg, fill.rgb);
    }
  }
  const backdrop = element => {
    const svg = element.closest("svg");
    if (backgrounds.has(svg)) return backgrounds.get(svg);
    const layers = [];
    for (let node = element; node; node = node.parentElement) layers.unshift(parse(getComputedStyle(node).backgroundColor));
    return layers.reduce((below, layer) => over(layer, below), [255, 255, 255]);
  };
  const describe = (element, what) => `${what}: <${element.tagName}> "${element.textContent.trim().slice(0, 40)}" in
    ${element.closest("[id], figure, .card, .table-wrap")?.className}`.replace(/\s+/g, " ");

  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    if (!walker.currentNode.data.trim() || element.closest("script, style") || !element.checkVisibility()) continue;
    count.texts++;
    const style = getComputedStyle(element), inFigure = element instanceof SVGElement, below = backdrop(element);
    const colour = parse(inFigure ? style.fill : style.color);
    const ratio = contrast(over({ ...colour, a: colour.a * opacity(element) }, below), below);
    if (ratio < TEXT) problems.push(describe(element, `contrast ${ratio.toFixed(2)}`));
    if (inFigure && canScroll && element.getBoundingClientRect().height < 9) problems.push(describe(element, "small"));
  }

  // The colour of grid lines, which only help.
  const probe = document.body.appendChild(document.createElement("i"));
  probe.style.color = "var(--grid)";
  const grid = parse(getComputedStyle(probe).color).rgb.join();
  probe.remove();
  for (const shape of document.querySelectorAll("svg path, svg use, svg line, svg rect, .bar > i")) {
    if (shape.closest("defs, clipPath") || !shape.checkVisibility() || opacity(shape) < 1) continue;
    const style = getComputedStyle(shape), below = backdrop(shape.parentElement);
    const colours = (shape instanceof SVGElement ? [style.fill, style.stroke] : [style.backgroundColor]).map(parse);
    const drawn = colours.filter((colour, i) => colour.a && !(i === 0 && shape instanceof SVGElement && style.fillOpacity < 1));
    if (!drawn.length || drawn.some(colour => colour.rgb.join() === grid)) continue;
    count.lines++;
    const ratio = Math.max(...drawn.map(colour => contrast(over(colour, below), below)));
    if (ratio < LINE) problems.push(describe(shape, `contrast ${ratio.toFixed(2)}`));
  }

  const width = document.documentElement.clientWidth;
  if (document.documentElement.scrollWidth > width) problems.push(`the page is ${document.documentElement.scrollWidth} wide`);
  for (const element of document.querySelectorAll("body *")) {
    if (!element.checkVisibility() || element.closest("defs, clipPath")) continue;
    const box = element.getBoundingClientRect(), scrolls = canScroll && element.parentElement.closest(".table-wrap, pre");
    if (!scrolls && (box.left < -1 || box.right > width + 1)) problems.push(describe(element, "outside of the page"));
    if (element.matches(".table-wrap, pre") && !canScroll && element.scrollWidth > element.clientWidth + 1)
      problems.push(describe(element, "cut off"));
    const figure = element.tagName === "text" && element.closest("svg").getBoundingClientRect();
    if (figure && (box.left < figure.left - 1 || box.right > figure.right + 1)) problems.push(describe(element, "outside of the figure"));
  }
  return { problems, figures: document.querySelectorAll("figure > svg").length, ...count };
}
