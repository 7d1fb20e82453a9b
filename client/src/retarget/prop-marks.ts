// Props on a stage: a small solid where hands hold on to something.

import * as THREE from "three";
import type { Theme } from "../view/palette";

const COLORS: Record<Theme, number> = { dark: 0x6ea0ff, light: 0x1f5fd0 };

export class PropMarks {
  readonly group = new THREE.Group();
  private readonly shape = new THREE.OctahedronGeometry(1);
  private readonly edges = new THREE.EdgesGeometry(this.shape);
  private readonly face = new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.35, depthWrite: false, toneMapped: false });
  private readonly line = new THREE.LineBasicMaterial({ toneMapped: false });

  /** Marks at places in the character's own space, so large in metres. */
  show(places: readonly (readonly number[])[], size: number): void {
    this.group.clear();
    for (const [x, y, z] of places) {
      const mark = new THREE.Group().add(new THREE.Mesh(this.shape, this.face), new THREE.LineSegments(this.edges, this.line));
      mark.position.set(x, y, z);
      mark.scale.setScalar(size);
      this.group.add(mark);
    }
  }

  paint(theme: Theme): void {
    this.face.color.setHex(COLORS[theme]);
    this.line.color.setHex(COLORS[theme]);
  }

  dispose(): void {
    this.group.removeFromParent();
    for (const held of [this.shape, this.edges, this.face, this.line]) held.dispose();
  }
}
