// A scene from the server becomes actors and animations.

import type { SceneData } from "./generated/messages";
import { ClipAnimation, MotionAnimation, type Animation } from "./anim/animation";
import { Arrays, type Container } from "./net/container";
import { Actor } from "./view/actor";
import { picture } from "./view/materials";

export interface OpenFile {
  id: string;
  name: string;
  format: string;
  unit: number;
  up: string;
  notes: string[];
  actors: Actor[];
  animations: Animation[];
  hasMesh: boolean;
  /** Give back what the graphics card holds; the actors are disposed of by the stage. */
  dispose: () => void;
}

export async function loadScene(container: Container<SceneData>): Promise<OpenFile> {
  const { header } = container;
  const arrays = new Arrays(container);
  const textures = await Promise.all(header.images.map((image) => picture(arrays.uint8(image.bytes), image.mime_type)));
  const notes = [...header.notes];
  header.images.forEach((image, n) => {
    if (!textures[n]) notes.push(`the picture '${image.name}' cannot be decoded by this browser`);
  });
  const animations = header.animations.map((data, n) =>
    data.kind === "clip" ? new ClipAnimation(data, arrays, header.id, n) : new MotionAnimation(data, arrays, header.id, n),
  );
  const stem = header.name.replace(/^sample:/, "").replace(/\.[^.]*$/, "");
  const actors = header.characters.map((data, n) => {
    const nameless = header.characters.length === 1 && /^(scene|root|rootnode|armature|untitled)?$/i.test(data.name);
    return new Actor(nameless ? { ...data, name: stem } : data, arrays, textures, header.id, n, stem);
  });
  return {
    id: header.id,
    name: header.name,
    format: header.format,
    unit: header.unit_m,
    up: header.up,
    notes,
    actors,
    animations,
    hasMesh: actors.some((actor) => actor.hasMesh),
    dispose: () => textures.forEach((texture) => texture?.dispose()),
  };
}
