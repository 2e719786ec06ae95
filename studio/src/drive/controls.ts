// What keys and gamepads say to a car.

/** throttle: 1 full acceleration, -1 full brake. steering: 1 to the left, -1 to the right. */
export interface Controls {
  throttle: number;
  steering: number;
}

/** What is read of a gamepad of the standard layout. */
export interface Pad {
  mapping: string;
  connected: boolean;
  axes: readonly number[];
  buttons: readonly { value: number }[];
}

const KEYS: Readonly<Record<string, Partial<Controls>>> = {
  ArrowUp: { throttle: 1 },
  ArrowDown: { throttle: -1 },
  ArrowLeft: { steering: 1 },
  ArrowRight: { steering: -1 },
  KeyW: { throttle: 1 },
  KeyS: { throttle: -1 },
  KeyA: { steering: 1 },
  KeyD: { steering: -1 },
};
const DEAD = 0.08; // of a stick that is let go
const BRAKE = 6; // buttons: the triggers
const ACCELERATE = 7;
const SHOULDERS = { left: 4, right: 5 } as const; // buttons
const TURN_S = 0.5; // in which a key turns the wheel from straight ahead to its end

export function isControl(code: string): boolean {
  return code in KEYS;
}

/** Of all keys that are down, by `KeyboardEvent.code`; opposite ones cancel each other, but the brake wins. */
export function ofKeys(down: ReadonlySet<string>): Controls {
  const pressed = [...down].map((code) => KEYS[code] ?? {});
  const brakes = pressed.some(({ throttle }) => throttle === -1);
  const throttle = brakes ? -1 : pressed.some((each) => each.throttle === 1) ? 1 : 0;
  const steering = Number(pressed.some((each) => each.steering === 1)) - Number(pressed.some((each) => each.steering === -1));
  return { throttle, steering };
}

/** Triggers and the left stick of the first gamepad that is used; null where none is. */
export function ofPads(pads: readonly (Pad | null)[]): Controls | null {
  for (const pad of pads) {
    if (!pad?.connected || pad.mapping !== "standard") continue;
    const stick = pad.axes[0] ?? 0;
    const steering = Math.abs(stick) < DEAD ? 0 : (-Math.sign(stick) * (Math.abs(stick) - DEAD)) / (1 - DEAD);
    const throttle = (pad.buttons[ACCELERATE]?.value ?? 0) - (pad.buttons[BRAKE]?.value ?? 0);
    if (throttle || steering) return { throttle, steering };
  }
  return null;
}

/** Whether a shoulder button of any gamepad is down. */
export function shoulders(pads: readonly (Pad | null)[]): { left: boolean; right: boolean } {
  const down = (button: number) =>
    pads.some((pad) => pad?.connected && pad.mapping === "standard" && (pad.buttons[button]?.value ?? 0) > 0.5);
  return { left: down(SHOULDERS.left), right: down(SHOULDERS.right) };
}

/** Where the steering wheel is some seconds later, which a key turns. */
export function turned(steering: number, towards: number, seconds: number): number {
  const most = seconds / TURN_S;
  return steering + Math.min(most, Math.max(-most, towards - steering));
}
