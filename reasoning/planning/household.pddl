; What a robot with one hand does in a home. Its sites are rooms and things: a site is beside the rooms from which it
; is reached, so that a door is beside two. A thing is reached from one site, and kept in what must be open to get at
; it: a container that can be shut, or else the room, which is always open.

(define (domain household)
 (:requirements :strips :typing :equality :negative-preconditions :universal-preconditions)

 (:types
   robot site - object
   room thing - site
   door - thing)

 (:predicates
   ; where the robot is, and what it holds
   (at ?r - robot ?s - site)
   (within ?r - robot ?m - room)
   (free ?r - robot)
   (holding ?r - robot ?x - thing)
   ; where things are
   (on ?x - thing ?h - thing)
   (in ?x - thing ?h - thing)
   (resting ?x - thing ?h - site)       ; on it or in it, or somewhere in a room
   (reached_from ?x - thing ?s - site)
   (kept ?x - thing ?c - site)
   (blocks ?x - thing ?d - door)
   ; states
   (opened ?c - site)
   (switched_on ?x - thing)
   (poured ?x - thing ?y - thing)
   ; what never changes
   (beside ?s - site ?m - room)
   (joins ?d - door ?a - room ?b - room)
   (graspable ?r - robot ?x - thing)
   (openable ?x - thing)
   (powered ?x - thing)
   (pourable ?x - thing)
   (vessel ?x - thing)
   (fits_on ?x - thing ?h - thing)
   (fits_in ?x - thing ?h - thing))

 ; drive to a site within the room
 (:action navigate
   :parameters (?r - robot ?from - site ?to - site ?m - room)
   :precondition (and (at ?r ?from) (within ?r ?m) (beside ?to ?m) (not (= ?from ?to)))
   :effect (and (not (at ?r ?from)) (at ?r ?to)))

 ; drive through a door into the next room
 (:action pass
   :parameters (?r - robot ?from - site ?d - door ?a - room ?b - room)
   :precondition (and (at ?r ?from) (within ?r ?a) (joins ?d ?a ?b) (opened ?d)
                      (forall (?x - thing) (not (blocks ?x ?d))))
   :effect (and (not (at ?r ?from)) (not (within ?r ?a)) (at ?r ?b) (within ?r ?b)))

 (:action open
   :parameters (?r - robot ?x - thing ?s - site)
   :precondition (and (at ?r ?s) (reached_from ?x ?s) (free ?r) (openable ?x) (not (opened ?x)))
   :effect (opened ?x))

 (:action close
   :parameters (?r - robot ?x - thing ?s - site)
   :precondition (and (at ?r ?s) (reached_from ?x ?s) (free ?r) (openable ?x) (opened ?x))
   :effect (not (opened ?x)))

 (:action switch_on
   :parameters (?r - robot ?x - thing ?s - site ?c - site)
   :precondition (and (at ?r ?s) (reached_from ?x ?s) (kept ?x ?c) (opened ?c) (free ?r) (powered ?x)
                      (not (switched_on ?x)))
   :effect (switched_on ?x))

 (:action switch_off
   :parameters (?r - robot ?x - thing ?s - site ?c - site)
   :precondition (and (at ?r ?s) (reached_from ?x ?s) (kept ?x ?c) (opened ?c) (free ?r) (powered ?x)
                      (switched_on ?x))
   :effect (not (switched_on ?x)))

 ; only what carries nothing is taken
 (:action pick
   :parameters (?r - robot ?x - thing ?h - site ?s - site ?c - site)
   :precondition (and (at ?r ?s) (reached_from ?x ?s) (resting ?x ?h) (kept ?x ?c) (opened ?c) (free ?r)
                      (graspable ?r ?x) (forall (?y - thing) (not (resting ?y ?x))))
   :effect (and (holding ?r ?x) (not (free ?r)) (not (resting ?x ?h)) (not (reached_from ?x ?s)) (not (kept ?x ?c))
                (forall (?y - thing) (and (not (on ?x ?y)) (not (in ?x ?y))))
                (forall (?d - door) (not (blocks ?x ?d)))))

 (:action place_on
   :parameters (?r - robot ?x - thing ?h - thing ?s - site ?c - site)
   :precondition (and (at ?r ?s) (reached_from ?h ?s) (kept ?h ?c) (opened ?c) (holding ?r ?x) (fits_on ?x ?h))
   :effect (and (not (holding ?r ?x)) (free ?r) (resting ?x ?h) (on ?x ?h) (reached_from ?x ?s) (kept ?x ?c)))

 ; into what cannot be shut: a bowl, a basket
 (:action place_in
   :parameters (?r - robot ?x - thing ?h - thing ?s - site ?c - site)
   :precondition (and (at ?r ?s) (reached_from ?h ?s) (kept ?h ?c) (opened ?c) (holding ?r ?x) (fits_in ?x ?h)
                      (not (openable ?h)))
   :effect (and (not (holding ?r ?x)) (free ?r) (resting ?x ?h) (in ?x ?h) (reached_from ?x ?s) (kept ?x ?c)))

 ; into what can: a cupboard, a fridge
 (:action place_inside
   :parameters (?r - robot ?x - thing ?h - thing ?s - site)
   :precondition (and (at ?r ?s) (reached_from ?h ?s) (opened ?h) (holding ?r ?x) (fits_in ?x ?h) (openable ?h))
   :effect (and (not (holding ?r ?x)) (free ?r) (resting ?x ?h) (in ?x ?h) (reached_from ?x ?s) (kept ?x ?h)))

 (:action pour
   :parameters (?r - robot ?x - thing ?y - thing ?s - site ?c - site)
   :precondition (and (at ?r ?s) (reached_from ?y ?s) (kept ?y ?c) (opened ?c) (holding ?r ?x) (pourable ?x)
                      (vessel ?y))
   :effect (poured ?x ?y))
)
