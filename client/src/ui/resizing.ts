// Pictures as large as their part of the page.

/** Tell of an element's size now and whenever it changes; returns what ends that. */
export function followSize(element: HTMLElement, resize: (width: number, height: number) => void): () => void {
  const observer = new ResizeObserver(() => resize(element.clientWidth, element.clientHeight));
  observer.observe(element);
  return () => observer.disconnect();
}
